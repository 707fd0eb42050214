"""The code of the serial architecture: its words, what each operation becomes, and where everything stands."""
