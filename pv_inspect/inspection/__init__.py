"""One inspection: its stages and parts, and what is said of it."""
