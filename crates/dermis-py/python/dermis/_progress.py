"""How far long work is, by tqdm where it is installed and somebody looks on."""

from __future__ import annotations

from collections.abc import Callable


def bar(label: str, total: int | None) -> Callable[[int | None], None]:
    """A bar for work that has taken a moment already.

    Parameters
    ----------
    label : str
        What is being done.
    total : int, optional
        Steps in all; without it, the time that has passed is shown alone.

    Returns
    -------
    callable
        Takes how many steps are done, or None at the end.
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
