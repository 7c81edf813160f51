"""The commands of `mecp-env`, one a module; `mecp_env.cli.main` loads only the one that is called."""
