"""The methods of others, each by its own weights or package."""
