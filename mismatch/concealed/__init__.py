"""Rigs that conceal an effect: own equations, integrator, steps and sensors, nothing shared with the diagnoser."""
