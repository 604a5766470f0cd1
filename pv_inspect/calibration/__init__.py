"""One camera for all frames, and a homography for each (paper, Sec. III-A and ref. [38])."""
