"""Every frame against the virtual module image (paper, Eq. 6)."""
