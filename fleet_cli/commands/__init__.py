"""The commands of ``fleet``, a module each."""
