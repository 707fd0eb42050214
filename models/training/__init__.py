"""Training: the objective over records (problem), its compiled gradients (kernels), Levenberg-Marquardt and descent."""
