"""What the fork server imports: the environment and its compiled functions, which its workers then share."""

from mecp_env import env  # noqa: F401
from mecp_env.core import warm_up

warm_up.load()
