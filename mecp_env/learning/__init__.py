"""How agents learn: configuration, networks, training and its files. Start with `train`.

Needs the extra `rl`; only `config` and `building_fields` do without PyTorch.
"""
