"""How agents learn: configuration, networks, training and its files. `python -m mecp_env.learning.train` is the way in.

Needs the extra `rl`; only `config` and `line` do without PyTorch.
"""
