"""What is learned from data, and what is known without it."""
