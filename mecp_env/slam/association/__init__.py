"""Data association (III-B): the associator of the estimator, its upper bound, and the registry of all others."""

from collections.abc import Callable

from mecp_env.slam.association.gating import MatchBuilder, ignored
from mecp_env.slam.association.mecp import JointDescriptorAssociator, MecpAssociator
from mecp_env.slam.association.oracle import OracleAssociator
from mecp_env.slam.association.posts import PostsApart
from mecp_env.slam.config import METHODS, AssociationConfig
from mecp_env.slam.custom import maker_of, register
from mecp_env.slam.protocols import Associator

ASSOCIATORS: dict[str, Callable[[AssociationConfig], Associator]] = {
    "mecp": MecpAssociator,
    "joint_descriptor": JointDescriptorAssociator,
    "known": OracleAssociator,
}


def register_associator(name: str, make: Callable[[AssociationConfig], Associator]) -> None:
    """Let `association.method` name a custom associator, in every configuration that this process reads.

    `make(config.association)` is called for each pipeline. A built-in name raises `ConfigError`; any other may be
    registered again. Other processes know it if they are forked from this one or import what registers it. States of
    an environment can hold it if `make` is its class.
    """
    register(METHODS, ASSOCIATORS, name, make)


def make_associator(config: AssociationConfig) -> Associator:
    """The associator that `config.method` names, which sees no posts of doors where `config.use_posts` is off.

    Known correspondences include those of posts.
    """
    associator = maker_of(ASSOCIATORS, config.method)(config)
    return associator if config.use_posts or associator.certain else PostsApart(associator, config)


__all__ = [
    "ASSOCIATORS",
    "Associator",
    "JointDescriptorAssociator",
    "MatchBuilder",
    "MecpAssociator",
    "OracleAssociator",
    "PostsApart",
    "ignored",
    "make_associator",
    "register_associator",
]
