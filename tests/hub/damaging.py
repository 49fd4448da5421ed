"""What a disk, a user or another tool can do to a folder: one random damage at a time."""

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

JUNK = [
    b"",
    b"garbage",
    b"\xff\xfe\x00\x80",
    b"\x00" * 64,
    b"1" * 40,
    b"../../../secret",
    b"[" * 200_000,
    b'{"files": 3}',
    b"{}",
]
STRAY_NAMES = [
    b"main~",
    b".DS_Store",
    b"\xff\xfe",
    b"two\nlines",
    b"a b",
    b"x.lock",
    b"0" * 40,
    b"\x1b[31mred",
]


def damage(rng: random.Random, repository: Path, outside: Path) -> str:
    """Damage one thing of a repository at random; what was done, for messages."""
    victims = [repository, *sorted(repository.rglob("*"))]
    victim = rng.choice(victims)
    if victim == repository and rng.random() < 0.9:
        victim = rng.choice(victims)
    make = rng.choice(DAMAGES)
    make(rng, victim, outside)
    return f"{make.__name__} {victim.relative_to(repository.parent)!r}"


def is_own_file(victim: Path) -> bool:
    """Whether what would be written to is the repository's, not another's behind a link."""
    if not victim.is_file():
        return False
    repository = next(parent for parent in victim.parents if parent.parent.name == "hub")
    return victim.resolve().is_relative_to(repository.resolve())


def delete(rng: random.Random, victim: Path, outside: Path) -> None:
    if victim.is_dir() and not victim.is_symlink():
        shutil.rmtree(victim)
    else:
        victim.unlink()


def truncate(rng: random.Random, victim: Path, outside: Path) -> None:
    if is_own_file(victim):
        os.truncate(victim, rng.randrange(victim.stat().st_size + 1))


def lengthen(rng: random.Random, victim: Path, outside: Path) -> None:
    if is_own_file(victim):
        with victim.open("ab") as file:
            file.write(b"\n")


def make_huge(rng: random.Random, victim: Path, outside: Path) -> None:
    if is_own_file(victim):
        os.truncate(victim, 1 << 24)


def flip(rng: random.Random, victim: Path, outside: Path) -> None:
    if is_own_file(victim) and victim.stat().st_size:
        content = bytearray(victim.read_bytes())
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        victim.write_bytes(content)


def overwrite(rng: random.Random, victim: Path, outside: Path) -> None:
    if is_own_file(victim):
        victim.write_bytes(rng.choice(JUNK))


def replace_by_file(rng: random.Random, victim: Path, outside: Path) -> None:
    delete(rng, victim, outside)
    victim.write_bytes(rng.choice(JUNK))


def replace_by_folder(rng: random.Random, victim: Path, outside: Path) -> None:
    delete(rng, victim, outside)
    victim.mkdir()
    if rng.random() < 0.5:
        (victim / "x").write_bytes(b"x")


def replace_by_fifo(rng: random.Random, victim: Path, outside: Path) -> None:
    delete(rng, victim, outside)
    os.mkfifo(victim)


def replace_by_link(rng: random.Random, victim: Path, outside: Path) -> None:
    hub = next(parent for parent in victim.parents if parent.name == "hub")
    others = [path for path in sorted(hub.rglob("*")) if path != victim]
    target = rng.choice([outside, outside / "secret", hub / "nowhere", victim, *rng.choices(others, k=4)])
    delete(rng, victim, outside)
    victim.symlink_to(target)


def move_out_and_link(rng: random.Random, victim: Path, outside: Path) -> None:
    target = outside / f"moved-{rng.random()}"
    victim.rename(target)
    victim.symlink_to(target)


def add_stray(rng: random.Random, victim: Path, outside: Path) -> None:
    folder = victim if victim.is_dir() else victim.parent
    path = Path(os.fsdecode(os.fsencode(folder) + b"/" + rng.choice(STRAY_NAMES)))
    if not os.path.lexists(path):
        rng.choice([Path.touch, Path.mkdir, os.mkfifo])(path)


def change_case(rng: random.Random, victim: Path, outside: Path) -> None:
    victim.rename(victim.with_name(victim.name.upper()))


def close(rng: random.Random, victim: Path, outside: Path) -> None:
    """Matters to users who are not root only."""
    if not victim.is_symlink():
        victim.chmod(0)


DAMAGES: list[Callable[[random.Random, Path, Path], None]] = [
    delete,
    truncate,
    lengthen,
    make_huge,
    flip,
    overwrite,
    replace_by_file,
    replace_by_folder,
    replace_by_fifo,
    replace_by_link,
    move_out_and_link,
    add_stray,
    change_case,
    close,
]
