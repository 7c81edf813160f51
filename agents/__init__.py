"""Policies, each with a command: `python -m agents.NAME`. They use only the public face of mecp_env.

An agent is a class with `actions`, the action mode that it wants of the environment, `reset(seed)` at the start of an
episode, and `act(observation, mask)`, which returns an action; `mask` is that of `GoalActions`, or None.
"""
