"""Progress of what takes longer than a moment, on the terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def shown(description: str) -> Iterator[Callable[[int, int], None]]:
    """A line that says what is being done, and how far it is once that is known.

    Yields:
        What to call with the numbers done and planned.
    """
    with named(description) as progress:
        yield lambda done, planned: progress(description, done, planned)


@contextmanager
def named(description: str) -> Iterator[Callable[[str, int, int], None]]:
    """As `shown`, for work of several kinds.

    Yields:
        What to call with the name of the work, and the numbers done and planned.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        line = bar.add_task(description, total=None)
        yield lambda name, done, planned: bar.update(line, description=name, completed=done, total=planned)
