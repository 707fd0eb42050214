"""The schedule of the folded architecture: words of weights, products, jobs, lines and their memories."""
