"""The result folder and the records in it."""
