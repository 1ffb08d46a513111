"""What `run`, `check`, `fetch` and `score.py` share: reading the sets, the frozen splits, the tasks and the tables."""
