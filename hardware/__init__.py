"""The Verilog on a simulator and in a synthesizer: benches that compare every bit, resources."""
