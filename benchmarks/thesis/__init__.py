"""Families and methods of the thesis that no command of greygate uses; benchmarks and pages compare with them."""
