"""The module image as the MAP estimate (paper, Sec. III-B, Eq. 7)."""
