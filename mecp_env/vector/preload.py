"""What the fork server imports: the environment and its compiled functions, which its workers then share."""

from mecp_env.vector.batch import load

load()
