"""The pump-controlled cylinder (thesis chapter 6)."""
