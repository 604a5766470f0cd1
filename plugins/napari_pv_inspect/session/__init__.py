"""What a result folder remembers from one session to the next."""
