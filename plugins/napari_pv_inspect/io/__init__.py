"""Opening and saving beside the window."""
