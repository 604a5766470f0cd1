"""The observation model of Eq. 1: blur, motion and sampling, with its adjoint."""
