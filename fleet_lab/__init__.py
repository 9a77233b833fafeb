"""What is done with the server offline: evaluation, identification, the paper, systems whose truth is known."""
