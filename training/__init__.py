"""Dataset, network and training loop of the neural controller."""
