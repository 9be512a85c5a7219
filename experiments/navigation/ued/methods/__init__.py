"""Methods: each is a function ``train(key, space, ppo)`` that yields the agent after each round of driving."""
