"""Training the networks: what is learnt from (`recipe`, `feed`), how (`loop`), and how well it goes (`check`)."""
