"""Data association (III-B): a small interface and the associators that ship."""

from collections.abc import Callable

from mecp_env.slam.association.base import Associator, ignored
from mecp_env.slam.association.known import KnownAssociator
from mecp_env.slam.association.mecp import MecpAssociator
from mecp_env.slam.association.mecp_paper import MecpPaperAssociator
from mecp_env.slam.association.nearest import NearestAssociator
from mecp_env.slam.config import AssociationConfig

ASSOCIATORS: dict[str, Callable[[AssociationConfig], Associator]] = {
    "mecp": MecpAssociator,
    "mecp_paper": MecpPaperAssociator,
    "nearest": NearestAssociator,
    "known": KnownAssociator,
}


def make_associator(config: AssociationConfig) -> Associator:
    """The associator that `config.method` names."""
    return ASSOCIATORS[config.method](config)


__all__ = [
    "ASSOCIATORS",
    "Associator",
    "KnownAssociator",
    "MecpAssociator",
    "MecpPaperAssociator",
    "NearestAssociator",
    "ignored",
    "make_associator",
]
