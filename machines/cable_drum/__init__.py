"""The cable-drum sensor (thesis chapter 7)."""
