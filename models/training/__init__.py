"""Training of networks on records.

record: what is learnt from. objective: residuals and their exact Jacobian through time, by the compiled functions of
kernels; variables: which weights move. loss: squared errors, decay and rehearsal. levenberg: Levenberg-Marquardt,
on the steps of gauss_newton, with checkpoint; descent: first-order methods. remarks: what records cannot tell.
"""
