"""Training: records, the objective over them, its compiled gradients (kernels), Levenberg-Marquardt and descent."""
