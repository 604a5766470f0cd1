"""The crossing points of the cells in every frame (paper, Sec. III-A and ref. [37])."""
