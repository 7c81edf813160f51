"""Short runnable scripts, one file per agent, on the public API: `python agents/bfs.py --help`."""
