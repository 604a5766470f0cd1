"""Training of the crack network and its judgement on labelled cells; needs torch."""
