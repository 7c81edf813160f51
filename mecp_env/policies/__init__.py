"""Exploration policies and their evaluation, through the public API of the environment.

A policy is a class with `actions`, the action mode that it needs, `reset(seed)` and `act(observation, mask)`.
"""

from mecp_env.policies.registry import Policy, choices, make_policy, policy_names

__all__ = ["Policy", "choices", "make_policy", "policy_names"]
