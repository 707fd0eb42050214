"""Proofs that a build's Verilog means what its integer program means, and what fixed point costs against float.

Each proof is a function that returns a `Proof`, or several; `greygate.hardware.proofs.build` calls all of them.
"""
