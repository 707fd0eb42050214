"""From recordings to a network, with no structure given: `greygate identify`.

`looking` says what the data are like, `ladder` which models compete, `halving` which of them wins on held-out blocks.
"""
