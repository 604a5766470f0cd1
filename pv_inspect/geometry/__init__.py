"""The module plane and the camera that sees it (paper, Sec. III-A)."""
