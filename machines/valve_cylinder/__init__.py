"""The valve-controlled cylinder (thesis chapter 5): plant, simulated line, recordings, network, study."""
