"""Rigs that conceal an effect, by which the diagnosis is judged.

This is an independent second implementation on purpose: it has its own equations, integrators, steps, sensors and
calibration, and shares no code with the plants and the diagnosis. A mistake that both made alike would pass unseen.
"""
