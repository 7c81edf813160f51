"""`python -m mecp_env` is the command `mecp-env`."""

import sys

from mecp_env.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
