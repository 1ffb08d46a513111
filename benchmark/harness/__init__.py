"""Code shared by `run`, `check`, `fetch` and `score.py`: data sets, frozen splits, tasks and tables."""
