"""The page of an evaluation: complete in one file, and what a browser makes of it."""

import json
import re
import shutil
import subprocess
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from small_policies import make_policy, save
from test_eval_episodes import rollout

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.core.played import describe
from lerobot_act_chunking.diagnostics.eval.films import choose
from lerobot_act_chunking.diagnostics.eval.page import HEIGHT, WIDTH, lines_of

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
VOID = {"meta", "link", "br", "img", "input", "hr"}
EPISODE = describe(rollout(), [0])


class Page(HTMLParser):
    """Whether all that is opened is closed, and what the page would load."""

    def __init__(self, text):
        super().__init__()
        self.open, self.loaded, self.words = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.loaded += [value for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory):
    """Two policies, one called by what HTML would take for a tag, with films."""
    folder = tmp_path_factory.mktemp("evaluation")
    first, second = (save(make_policy(n_action_steps=n), folder / f"policy_{n}") for n in (3, 8))
    out = folder / "out"
    asked = ["--env.type=aloha_sim", "--env.obs_type=state", "--env.episode_length=6", "--episodes=4"]
    asked += ["--batch-size=4", "--workers=1", f"--output-dir={out}", "--videos=1"]
    assert main(["eval", f"<b>={first}", f"whole={second}", *asked, f"--json={folder / 'e.json'}"]) == 0
    return folder


@pytest.fixture(scope="module")
def page(evaluation):
    return (evaluation / "out" / "report.html").read_text()


def test_all_is_there_in_one_file(page):
    read = Page(page)
    text = " ".join(" ".join(read.words).split())
    assert read.open == []
    for words in ("Success", "Comparison", "Failures", "Acting", "Episodes", "What was run", "<b>", "whole"):
        assert words in text
    assert "<b>=" not in page
    assert "0 of 4" in text
    assert all(each.startswith("data:video/mp4;base64,") for each in read.loaded)
    assert len(read.loaded) == 2
    assert not re.search(r"https?://", page)


def test_the_page_is_small(page):
    without_films = re.sub(r"data:video/mp4;base64,[^\"]*", "", page)
    assert len(without_films) < 5_000_000


def test_numbers_are_those_of_the_json(evaluation, page):
    content = json.loads((evaluation / "e.json").read_text(), parse_constant=pytest.fail)
    assert (content["tool"], content["verdict"]) == ("eval", "warn")  # nobody has trained them
    assert "untrained" in content["reasons"][0]
    assert [each["title"] for each in content["policies"]] == ["<b>", "whole"]
    for each in content["policies"]:
        assert (each["successes"], each["episodes"]) == (0, 4)
        assert each["checkpoint"] in page


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize("dark", [False, True])
def test_a_browser_shows_it(dark, evaluation, tmp_path):
    picture = tmp_path / "page.png"
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={tmp_path / 'profile'}",
    ]
    command += ["--force-dark-mode", "--blink-settings=preferredColorScheme=0"] if dark else []
    command += ["--window-size=1100,1600", f"--screenshot={picture}", "--enable-logging=stderr", "--v=0"]
    shown = subprocess.run(
        [*command, (evaluation / "out" / "report.html").as_uri()], capture_output=True, text=True, timeout=120
    )
    assert shown.returncode == 0
    assert "CONSOLE" not in shown.stderr
    from PIL import Image

    pixels = np.asarray(Image.open(picture).convert("L")).astype(float)
    assert pixels.std() > 10  # not blank
    assert (np.median(pixels) < 64) == dark


def test_one_failure_of_each_kind_comes_first():
    kinds = ["dropped", "dropped", "dropped", "missed grasp", None, "dropped", "stalled"]
    episodes = [
        replace(EPISODE, seed=seed, success=kind is None, failure=kind) for seed, kind in enumerate(kinds)
    ]
    chosen = [kinds[place] for place in choose(episodes, 4)]
    assert chosen[0] == "dropped"
    assert Counter(chosen[:3]) == {"dropped": 1, "missed grasp": 1, "stalled": 1}
    assert choose(episodes, 7)[-1] == 4
    assert choose(episodes, 0) == []


def test_lines_stay_within_their_place():
    commands = np.stack([np.linspace(-3, 5, 700), np.ones(700)], axis=1)
    rising, flat = lines_of(commands, ["a", "b"])
    points = np.array([each.split(",") for each in rising.command.split()], float)
    assert (points[0, 0], points[-1, 0]) == (0, WIDTH)
    assert (rising.low, rising.high) == (-3, 5)
    assert ((points[:, 1] >= 0) & (points[:, 1] <= HEIGHT)).all()
    assert (np.diff(points[:, 1]) <= 0).all()  # up is up
    assert len({each.split(",")[1] for each in flat.command.split()}) == 1
    assert lines_of(commands[:1], ["a", "b"])[0].command
