"""Some calls of the campaign of hostile calls (tests/adversary.py); `make fuzz` makes thousands."""

import pytest
from adversary import Campaign, run, wrong
from adversary_material import VALID, material

# Of commands that end in a second.
CALLS = [("loop", 8), ("rods", 2), ("markers", 5), ("measure", 8), ("show", 8)]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adversary")
    return Campaign(folder, material(folder / "files"))


@pytest.mark.parametrize("command, count", CALLS)
def test_hostile_calls_end_as_they_may(campaign, command, count, tried):
    bad, refused = [], 0
    for number in range(count):
        kind, words, around = campaign.drawn(1, number, command)
        end, left = run(words, around, campaign.folder / "run", campaign.files)
        refused += end.code == 2
        said = wrong(end, left, around)
        if said:
            bad.append(f"{kind}: {said}")
    tried["calls"] = (count, refused)
    assert not bad, "\n".join(bad)


def test_what_is_broken_was_a_valid_call(campaign):
    assert VALID.keys() == campaign.commands.keys()
    files = {f"{{{name}}}": path for name, path in campaign.files.items()}
    for name, words in VALID.items():
        words = [files.get(word, word) for word in words]
        campaign.commands[name].make_context(name, words)
