"""What programs use to talk to a gateway over the bus."""
