"""The command ``fleet``: thin; it parses, starts and prints."""
