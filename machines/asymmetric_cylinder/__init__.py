"""The asymmetric cylinder to which the first machine's network is adapted (thesis 5.4)."""
