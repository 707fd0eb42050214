"""Control with structured networks: prediction, predictive control, its imitation by a network, and closed loops."""
