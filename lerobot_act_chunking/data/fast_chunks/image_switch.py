"""Images are decoded only for the batches in which a policy looks at them."""

import torch


class ImageSwitch:
    """Shared between a policy, which turns it, and the data workers, which obey.

    Workers are ahead of the policy: a batch that it will see is made some batches before. ``ahead`` says how
    many; images have to be wanted again that many batches before they are looked at.
    """

    def __init__(self) -> None:
        self._off = torch.zeros((), dtype=torch.bool).share_memory_()
        self.ahead = 0
        self.expect_workers(0, 0)

    def expect_workers(self, num_workers: int, prefetch_factor: int) -> None:
        """Learn how far the data workers of a run are ahead.

        Batches under way are those that workers make (``num_workers * prefetch_factor``), one more that
        accelerate keeps, the one asked for next, and the one at hand.
        """
        self.ahead = num_workers * prefetch_factor + 3

    @property
    def off(self) -> bool:
        """Whether batches that are made now need no images."""
        return bool(self._off)

    def want_images_in(self, n_batches: int) -> None:
        """Say that images are looked at after ``n_batches`` batches, counted from the one at hand."""
        self._off.fill_(n_batches > self.ahead)
