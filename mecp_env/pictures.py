"""The public face of `mecp_env.render`: films and small pictures, for whoever compares policies."""

from mecp_env.render.film import Film
from mecp_env.render.thumbnail import thumbnail
from mecp_env.render.view import View

__all__ = ["Film", "View", "thumbnail"]
