"""A candidate for placing markers on a rig, compared with the shipped registration.

By labels and landmarks that are read from what the rig's shapes do, else by symmetry and motion.
`benchmarks.real_captures` prints both side by side. It is not in the package yet: the baseline, the
selection and the binding still use `numerics.registration`.
"""
