"""What the command line and a build may say of formats. Every start reads this file, so it imports nothing."""

NARROWEST, WIDEST = 4, 32  # bits of a word
FINER = WIDEST - NARROWEST  # bits that weights and neurons may have beyond the word
