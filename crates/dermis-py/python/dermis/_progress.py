"""Progress of long work, shown by tqdm if it is installed and the output is a terminal or a notebook."""

from __future__ import annotations

from collections.abc import Callable


def bar(label: str, total: int | None) -> Callable[[int | None], None]:
    """A bar for work that has already taken a moment.

    Parameters
    ----------
    label : str
        Name of the work.
    total : int, optional
        Total number of steps; without it, only the elapsed time is shown.

    Returns
    -------
    callable
        Takes the number of steps done, or None at the end.
    """
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return lambda done: None
    shape = None if total is not None else "{desc}: {elapsed}"
    shown = tqdm(desc=label, total=total, leave=False, disable=None, bar_format=shape)

    def show(done: int | None) -> None:
        if done is None:
            shown.close()
        elif total is None:
            shown.refresh()
        else:
            shown.update(done - shown.n)

    return show
