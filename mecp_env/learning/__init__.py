"""How agents learn: configuration, networks, training and its files. Start with `train`.

Needs the extra `rl`; only `config` does without PyTorch.
"""
