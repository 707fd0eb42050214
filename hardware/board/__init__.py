"""A compiled network on a board: a folder that builds its bitstream, and the host that plays a recording through it."""
