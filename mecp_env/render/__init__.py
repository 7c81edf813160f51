"""Pictures of an episode: `screen` draws frames with pygame-ce, `figures` draws figures with matplotlib."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # before anything here imports pygame: no greeting on stdout
