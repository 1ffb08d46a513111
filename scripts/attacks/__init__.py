"""The attacks that scripts/attack runs on the built command."""
