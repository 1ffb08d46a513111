"""What scripts/attack does to the built command."""
