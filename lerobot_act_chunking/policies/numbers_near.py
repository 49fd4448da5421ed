"""Numbers that would have worked, for the messages that refuse one."""


def near_multiples(number: int, step: int) -> str:
    """The multiples of ``step`` to either side of ``number``, as ``6 or 8``."""
    below = number // step * step
    return " or ".join(str(each) for each in (below, below + step) if each)


def near_divisors(number: int, divisor: int) -> str:
    """The divisors of ``number`` to either side of ``divisor``, as ``1 or 7``."""
    below = max(each for each in range(1, min(divisor, number) + 1) if number % each == 0)
    above = [each for each in range(divisor, number + 1) if number % each == 0][:1]
    return " or ".join(str(each) for each in (below, *above))
