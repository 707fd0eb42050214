"""Training of networks on records.

record: what is learnt from. objective: residuals and their exact Jacobian through time, by the compiled functions of
kernels. loss: squared errors, decay and rehearsal. levenberg: Levenberg-Marquardt, on the steps of gauss_newton.
remarks: what records cannot tell.
"""
