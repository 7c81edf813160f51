"""From belief to path: goals, paths, control, the paper's explorer. It uses the estimate only, never ground truth."""
