"""Families of networks: library networks of known functions, tanh and radial blocks, regressions, templates."""
