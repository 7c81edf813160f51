"""The commands of `mecp-env`, one a module; `mecp_env.cli` loads only the one that is called."""
