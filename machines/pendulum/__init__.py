"""A pendulum turned by a motor: the smallest machine here, and the pattern for a machine of your own."""
