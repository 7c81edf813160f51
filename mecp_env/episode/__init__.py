"""One episode of the environment: true world, start, actions, observations, rewards, state."""
