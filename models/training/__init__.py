"""Training: records, the objective over them and its gradients, the loss, Levenberg-Marquardt and descent."""
