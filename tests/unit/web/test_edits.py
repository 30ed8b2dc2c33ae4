"""Edits of a job: what the text is afterwards, to the letter, and what `load_job` reads in it."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from updyn.errors import InputError, JobError
from updyn.job import Job, load_job
from updyn.web import edits

TEXT = """\
# a job of somebody who comments
title = "x"   # kept

# the model
[model]
file = "m.h5"

# the measurement
[test]
file = "t.uff"  # of May
#band = [1, 2]

# unknowns
[[parameter]]  # one
groups = "part*"
quantity = "mass"  # all of them
bounds = [0.3, 3.0] # wide

# two
[[parameter]]
groups = ["part1", "part2"]
quantity = "stiffness"

# the fit
[method]
name = "output-error"
"""
TWO = """\
[model]
file = "m.h5"

[[test]]
name = "free"
file = "a.uff"
validation = ["1:X"]

# with the brake on
[[test]]
name = "braked"
file = "b.uff"
grounded = ["9:X"]

[[parameter]]
groups = "all"
quantity = "stiffness"
"""
LINKED = """\
[model]
file = "m.h5"
[test]
file = "t.uff"
[[parameter]]
name = "dish.thickness"
drives = { "part1.stiffness" = 3, "part1.mass" = 1 }
nominal = 2e-3
[[parameter]]
groups = ["part1", "glue"]
quantity = "viscous"
"""
GROUPS = ["part1", "part2", "part3"]
ABLE = dict.fromkeys(("stiffness", "mass", "loss_factor"), GROUPS)


def edited(edit: Callable[[Any], None], text: str = TEXT) -> str:
    document = tomlkit.parse(text)
    edit(document)
    return tomlkit.dumps(document)


def job(text: str) -> Job:
    found = load_job(Path("job.toml"), text=text)
    assert isinstance(found, Job)
    return found


def unknowns(text: str) -> list[tuple[Any, ...]]:
    return [(p.quantity, p.groups, p.bounds) for p in job(text).parameter]


def comments(text: str) -> list[str]:
    return [line.partition("#")[2].strip() for line in text.splitlines() if "#" in line]


def lines_added(before: str, after: str) -> list[str]:
    """What was put between the lines of a text, all of which are still there in their order."""
    left = iter(before.splitlines())
    expected, added = next(left, None), []
    for line in after.splitlines():
        if line == expected:
            expected = next(left, None)
        else:
            added.append(line)
    assert expected is None, f"{expected!r} is gone"
    return added


# -- lines that are used
def test_a_new_table_has_the_proposed_bounds() -> None:
    proposals = {"mass": {"bounds": (0.5, 2.0)}, "stiffness": {"bounds": (0.2, 5.0)}}
    bare = '[test]\nfile = "a.uff"\n'
    text = edited(edits.set_unknowns({"mass": ["part1"]}, ABLE, proposals), bare)
    assert tomllib.loads(text)["parameter"] == [
        {"groups": ["part1"], "quantity": "mass", "bounds": [0.5, 2.0]}
    ]


def test_a_band_is_a_key_of_the_test_and_not_of_what_follows() -> None:
    text = edited(edits.set_band(5.0, 400.0))
    assert text == TEXT.replace("#band = [1, 2]\n", "#band = [1, 2]\nband = [5.0, 400.0]\n")
    assert job(text).test.band == (5.0, 400.0)
    again = edited(edits.set_band(6.25, 123.4567891), text)
    assert again == text.replace("[5.0, 400.0]", "[6.25, 123.45679]")


def test_lines_are_left_out_one_band_after_the_other_and_taken_back() -> None:
    one = edited(edits.exclude(49.5, 50.5))
    assert lines_added(TEXT, one) == ["exclude = [[49.5, 50.5]]"]
    two = edited(edits.exclude(99.0, 101.0), one)
    assert job(two).test.exclude == ((49.5, 50.5), (99.0, 101.0))
    assert edited(edits.include_all(), two) == TEXT
    assert edited(edits.include_all(), TEXT) == TEXT


def test_a_test_among_several() -> None:
    text = edited(edits.set_band(1.0, 2.0, 1), edited(edits.exclude(1.2, 1.3, 1), TWO))
    assert sorted(lines_added(TWO, text)) == ["band = [1.0, 2.0]", "exclude = [[1.2, 1.3]]"]
    first, second = (part.test for part in job(text).parts)
    assert (first.band, first.exclude) == (None, None)
    assert (second.name, second.band, second.exclude) == ("braked", (1.0, 2.0), ((1.2, 1.3),))
    first = job(edited(edits.set_band(1.0, 2.0, 0), TWO)).parts[0].test
    assert (first.name, first.band) == ("free", (1.0, 2.0))
    with pytest.raises(InputError, match="2 tests, and no number 3"):
        edited(edits.set_band(1.0, 2.0, 2), TWO)


@pytest.mark.parametrize(
    "test",
    [
        '[test]\nfile = "t.uff"\n[test.masses]\n"3:X" = 0.1\n',
        '[test]\nfile = "t.uff"\nmasses = { "3:X" = 0.1 }\n[match]\nby = "label"\n',
        '[test]\nfile = "t.uff"\nmasses."3:X" = 0.1\n',
        '[test]\nmasses."3:X" = 0.1\nfile = "t.uff"',
    ],
)
def test_every_way_to_write_the_table_of_a_test(test: str) -> None:
    """The table of a test with tables in it; those of the model are before and after it."""
    rest = '[model]\nfile = "m.h5"\n[[parameter]]\ngroups = "a"\nquantity = "mass"\n'
    for text in (rest + test, test + "\n" + rest):
        new = edited(edits.exclude(1.0, 2.0), edited(edits.set_band(1.0, 9.0), text))
        found = job(new).test
        assert (found.file, found.band, found.exclude) == ("t.uff", (1.0, 9.0), ((1.0, 2.0),))
        assert found.masses == {"3:X": 0.1}


def test_an_inline_table_and_dotted_keys() -> None:
    rest = '[model]\nfile = "m.h5"\n[[parameter]]\ngroups = "a"\nquantity = "mass"\n'
    for text in ('test = { file = "t.uff" }\n', 'test.file = "t.uff"\n'):
        assert job(edited(edits.set_band(1.0, 9.0), text + rest)).test.band == (1.0, 9.0)


# -- repairs, validation, matching
def test_repairs_are_added_once() -> None:
    one = edited(edits.add_repair("sign of 3:X"))
    assert lines_added(TEXT, one) == ['repair = ["sign of 3:X"]']
    assert edited(edits.add_repair("sign of 3:X"), one) == one
    two = edited(edits.add_repair("delay"), one)
    assert job(two).test.repair == ("sign of 3:X", "delay")
    assert comments(two) == comments(TEXT)


def test_responses_are_held_out_in_the_method() -> None:
    one = edited(edits.hold_out(["5:X", "7:X"]))
    assert lines_added(TEXT, one) == ['validation = ["5:X", "7:X"]']
    assert job(one).method.validation == ("5:X", "7:X")
    assert edited(edits.hold_out([]), one) == TEXT


def test_or_in_the_test_that_has_its_own() -> None:
    text = edited(edits.hold_out(["2:X"], 0), TWO)
    assert text == TWO.replace('validation = ["1:X"]', 'validation = ["2:X"]')
    of_all = job(edited(edits.hold_out(["3:X"], 1), TWO))
    assert [part.validation for part in of_all.parts] == [("1:X",), ("3:X",)]


def test_what_the_method_holds_out_of_several_tests_stays_that_of_the_others() -> None:
    text = TWO.replace('validation = ["1:X"]\n', "") + '[method]\nvalidation = ["1:X"]\n'
    for chosen, expected in ((["3:X"], ("3:X",)), ([], None)):
        new = job(edited(edits.hold_out(chosen, 1), text))
        assert [part.validation for part in new.parts] == [("1:X",), expected]
        assert new.method.validation is None
    new = job(
        edited(edits.hold_out(["3:X"], 1), text.replace('[method]\nvalidation = ["1:X"]', ""))
    )
    assert [part.validation for part in new.parts] == [None, ("3:X",)]


def test_a_sensor_is_matched() -> None:
    one = edited(edits.match_sensor("5:X", "7:-Z"))
    assert lines_added(TEXT, one) == ["", "[match.table]", '"5:X" = "7:-Z"']
    two = edited(edits.match_sensor("5:X", "8:Z"), edited(edits.match_sensor("a b", "1:Y"), one))
    assert job(two).match.table == {"5:X": "8:Z", "a b": "1:Y"}


@pytest.mark.parametrize(
    "match",
    [
        '[match]\nby = "coordinates" # why\nunit = "mm"\n',
        '[match]\nby = "coordinates" # why\nunit = "mm"\n[match.table]\n"1:X" = "2:X"\n',
        '[match]\nby = "coordinates" # why\nunit = "mm"\ntable = { "1:X" = "2:X" }\n',
        '[match]\nby = "coordinates" # why\nunit = "mm"\n[match.directions]\n"1:a" = [1, 0, 0]\n',
        '[match]\nby = "coordinates" # why\nunit = "mm"\ntable."1:X" = "2:X"\n',
    ],
)
def test_a_sensor_is_matched_beside_what_is_there(match: str) -> None:
    text = TEXT + "\n" + match
    new = edited(edits.match_sensor("5:X", "7:Z"), text)
    found, before = job(new).match, job(text).match
    assert found.table == {**before.table, "5:X": "7:Z"}
    assert (found.by, found.unit, found.directions) == ("coordinates", "mm", before.directions)
    assert comments(new) == [*comments(TEXT), "why"]


# -- keys of a table
def test_a_key_is_set_changed_and_left_out() -> None:
    one = edited(edits.set_key("modes", "damping", "viscous"))
    assert lines_added(TEXT, one) == ["", "[modes]", 'damping = "viscous"']
    two = edited(edits.set_key("method", "max_iterations", 7), one)
    assert comments(two) == comments(TEXT)
    assert job(two).method.options["max_iterations"] == 7
    three = edited(edits.set_key("method", "max_iterations", 8), two)
    assert three == two.replace("max_iterations = 7", "max_iterations = 8")
    assert edited(edits.set_key("method", "max_iterations", None), three) == one
    assert edited(edits.set_key("method", "no_such", None), one) == one


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("number", "2.5e3", 2500.0), ("number", " 7 ", 7.0), ("whole", " 12 ", 12),
        ("numbers", "5, 400", [5.0, 400.0]), ("numbers", "5,", [5.0]),
        ("texts", "1:X, 2:Y ,", ["1:X", "2:Y"]), ("text", "a, b", "a, b"), ("choice", "d-optimal", "d-optimal"),
        ("band", "0, 4e2", [0.0, 400.0]), ("number", "", None), ("whole", "  ", None), ("numbers", " , ", None), ("texts", ",", None),
        ("text", " ", None),
    ],
)  # fmt: skip
def test_what_is_typed_as_a_value(kind: str, text: str, value: object) -> None:
    found = edits.as_value(kind, text, "label")
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        ("number", "1,5", "a number"), ("number", "x", "a number"), ("number", "nan", "a number"),
        ("number", "inf", "a number"), ("whole", "2.5", "a whole number"), ("whole", "1e3", "a whole number"),
        ("numbers", "1; 2", "numbers and commas"), ("numbers", "1, inf", "numbers and commas"),
        ("band", "400, 5", "two frequencies, the lower one first"), ("band", "5", "two frequencies, the lower one first"),
    ],
)  # fmt: skip
def test_what_is_no_value_is_said_with_its_label(kind: str, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        edits.as_value(kind, text, "sensors")
    assert str(caught.value) == f"sensors: {text!r}; expected {expected}"


# -- picks
def test_picks_are_written_in_order_and_taken_back() -> None:
    text = edited(edits.set_picks([23.61234567, 11.9], []))
    assert lines_added(TEXT, text) == ["", "[modes]", "pick = [11.9, 23.61235]"]
    text = edited(edits.set_picks([], [853.492]), text)
    assert "poles = [853.492]" in text
    assert "pick" not in text
    both = edited(edits.set_picks([11.9], [853.492, 31]), text)
    assert "pick = [11.9]" in both
    assert "poles = [31.0, 853.492]" in both
    none = edited(edits.set_picks([], []), both)
    assert "pick" not in none
    assert "poles" not in none
    job(none)


# -- lines that the method lists
def test_listed_lines_are_kept_where_they_are_still_used() -> None:
    text = edited(edits.set_key("method", "lines", [2.0, 4.0, 8.0]))
    assert job(edited(edits.set_band(3.0, 9.0), text)).method.lines == (4.0, 8.0)
    assert job(edited(edits.exclude(3.0, 5.0), text)).method.lines == (2.0, 8.0)
    assert job(edited(edits.exclude(1.0, 9.0), text)).method.lines is None
    assert job(edited(edits.set_band(1.0, 9.0), text)).method.lines == (2.0, 4.0, 8.0)


# -- unknowns
def test_what_is_chosen_already_keeps_its_text() -> None:
    chosen = {"mass": GROUPS, "stiffness": ["part2", "part1"]}
    assert edited(edits.set_unknowns(chosen, ABLE, {})) == TEXT


def test_a_group_fewer_is_listed_and_one_more_goes_to_its_quantity() -> None:
    text = edited(edits.set_unknowns({"mass": ["part3", "part1"], "stiffness": GROUPS}, ABLE, {}))
    assert text == TEXT.replace('"part*"', '["part1", "part3"]').replace(
        '["part1", "part2"]', '["part1", "part2", "part3"]'
    )
    assert unknowns(text) == [
        ("mass", ("part1", "part3"), (0.3, 3.0)), ("stiffness", tuple(GROUPS), None),
    ]  # fmt: skip


def test_a_new_quantity_gets_a_table_before_what_is_said_of_the_next() -> None:
    chosen = {"mass": GROUPS, "stiffness": ["part1", "part2"], "loss_factor": ["part2"]}
    text = edited(edits.set_unknowns(chosen, ABLE, {}))
    new = '[[parameter]]\ngroups = ["part2"]\nquantity = "loss_factor"\n'
    assert text == TEXT.replace("\n# the fit\n", f"\n{new}\n# the fit\n")
    assert unknowns(text)[2] == ("loss_factor", ("part2",), None)


@pytest.mark.parametrize("chosen", [{"stiffness": ["part1", "part2"]}, {"mass": GROUPS}, {}])
def test_a_table_without_groups_goes_and_no_comment_on_others_with_it(chosen: Any) -> None:
    every = {"mass": [], "stiffness": [], **chosen}
    text = edited(edits.set_unknowns(every, ABLE, {}))
    of_tables = {"one", "all of them", "wide"}
    assert set(comments(TEXT)) - set(comments(text)) <= of_tables
    if chosen:
        assert {(q, frozenset(g)) for q, g, _ in unknowns(text)} <= {
            ("mass", frozenset(["part*"])), ("stiffness", frozenset(["part1", "part2"])),
        }  # fmt: skip
        assert len(unknowns(text)) == 1
    else:
        with pytest.raises(JobError, match="parameter"):
            job(text)
    back = edited(edits.set_unknowns({"mass": ["part1"], "stiffness": []}, ABLE, {}), text)
    assert [(q, g) for q, g, _ in unknowns(back)] == [("mass", ("part1",))]


def test_unknowns_of_a_job_that_has_none() -> None:
    bare = '[model]\nfile = "m.h5"\n[test]\nfile = "t.uff"\n'
    for text in (bare, 'parameter = []\ntitle = "x"\n' + bare):
        assert edited(edits.set_unknowns({"mass": []}, ABLE, {}), text).endswith(bare)
        new = edited(edits.set_unknowns({"mass": ["part2"]}, ABLE, {}), text)
        assert unknowns(new) == [("mass", ("part2",), None)]
        assert job(new).title == ("x" if "title" in text else "")


def test_all_becomes_a_list_where_a_group_goes() -> None:
    text = edited(edits.set_unknowns({"stiffness": ["part3", "part1"]}, ABLE, {}), TWO)
    assert text == TWO.replace('"all"', '["part1", "part3"]')


def test_unknowns_that_are_not_chosen_by_quantity_stay() -> None:
    """Linked ones, quantities that the page does not offer, and masses that a test adds."""
    text = edited(edits.set_unknowns({"stiffness": ["part2"], "mass": []}, ABLE, {}), LINKED)
    assert lines_added(LINKED, text)[-3:] == [
        "[[parameter]]", 'groups = ["part2"]', 'quantity = "stiffness"',
    ]  # fmt: skip
    added = LINKED + '[[parameter]]\ngroups = "added mass"\nquantity = "mass"\n'
    assert edited(edits.set_unknowns({"stiffness": [], "mass": []}, ABLE, {}), added) == added


def test_two_tables_of_one_quantity() -> None:
    text = LINKED + (
        '[[parameter]]\ngroups = "part1"\nquantity = "mass"\nnominal = 3.0\n'
        '[[parameter]]\ngroups = "part[23]"\nquantity = "mass"\nbounds = [0.5, 2.0]\n'
    )
    assert edited(edits.set_unknowns({"mass": GROUPS}, ABLE, {}), text) == text
    fewer = edited(edits.set_unknowns({"mass": ["part1"]}, ABLE, {}), text)
    again = edited(edits.set_unknowns({"mass": ["part1", "part3"]}, ABLE, {}), fewer)
    assert [p.groups for p in job(again).parameter if p.quantity == "mass"] == [
        ("part1",), ("part3",),
    ]  # fmt: skip


# -- bounds
def test_bounds_of_one_unknown_of_several() -> None:
    text = edited(edits.set_bounds("part2.mass", 0.5, 2, GROUPS))
    own = '[[parameter]]\ngroups = ["part2"]\nquantity = "mass"\nbounds = [0.5, 2.0]\n'
    assert text == TEXT.replace('"part*"', '["part1", "part3"]').replace(
        "\n# the fit\n", f"\n{own}\n# the fit\n"
    )
    again = edited(edits.set_bounds("part2.mass", 0.6, 1234567.5, GROUPS), text)
    assert again == text.replace("[0.5, 2.0]", "[0.6, 1234567.5]")
    assert unknowns(again) == [
        ("mass", ("part1", "part3"), (0.3, 3.0)), ("stiffness", ("part1", "part2"), None),
        ("mass", ("part2",), (0.6, 1234567.5)),
    ]  # fmt: skip


def test_what_else_the_table_says_goes_with_the_group() -> None:
    text = TEXT.replace(
        'quantity = "stiffness"\n', 'quantity = "stiffness"\nprior_std = 0.2\nstart = 1.1\n'
    )
    *_, shared, own = job(
        edited(edits.set_bounds("part1.stiffness", 0.5, 2.0, GROUPS), text)
    ).parameter
    assert (shared.groups, shared.bounds, shared.prior_std, shared.start) == (
        ("part2",),
        None,
        0.2,
        1.1,
    )
    assert (own.groups, own.bounds, own.prior_std, own.start) == (("part1",), (0.5, 2.0), 0.2, 1.1)


def test_bounds_of_a_linked_unknown_and_of_an_added_mass() -> None:
    text = edited(edits.set_bounds("dish.thickness", 0.8, 1.25, GROUPS), LINKED)
    assert lines_added(LINKED, text) == ["bounds = [0.8, 1.25]"]
    assert job(text).parameter[0].bounds == (0.8, 1.25)
    added = LINKED + '[[parameter]]\ngroups = "added mass"\nquantity = "mass"\n'
    text = edited(edits.set_bounds("added mass.mass", 0.8, 1.25, GROUPS), added)
    assert lines_added(added, text) == ["bounds = [0.8, 1.25]"]


def test_bounds_of_an_unknown_that_no_table_chooses() -> None:
    with pytest.raises(InputError, match=r"no \[\[parameter\]\] of the job chooses 'glue.mass'"):
        edited(edits.set_bounds("glue.mass", 0.5, 2.0, GROUPS))


# -- what is no job
BAD = (
    "test = 3\nmatch = 3\nmethod = 3\nmodes = 3\nparameter = 3\n",
    'test = "x"\nmatch = [1]\nmethod = true\nmodes = "x"\n[parameter]\ngroups = "all"\n',
    "[test]\nexclude = 5\nrepair = 5\n[match]\ntable = 5\n[modes]\npick = 5\n[[parameter]]\ngroups = 5\nquantity = 5\n",
    '[test]\nexclude = "x"\nrepair = "x"\n[modes]\npick = ["x"]\n[[parameter]]\ngroups = [5]\nquantity = "mass"\n',
    'parameter = [{ groups = "all", quantity = "mass" }]\n',
    '[[parameter]]\nquantity = "mass"\n',
    "[method]\nlines = [1, \"x\"]\n[[test]]\n",
    "[[test]]\n[[match]]\n[[method]]\n[[modes]]\n",
    "",
)  # fmt: skip
EDITS = {
    "band": edits.set_band(1.0, 2.0),
    "exclude": edits.exclude(1.0, 2.0),
    "include": edits.include_all(),
    "repair": edits.add_repair("delay"),
    "hold": edits.hold_out(["1:X"]),
    "hold none": edits.hold_out([]),
    "match": edits.match_sensor("1:X", "2:X"),
    "key": edits.set_key("modes", "damping", "viscous"),
    "no key": edits.set_key("modes", "damping", None),
    "pick": edits.set_picks([3.0], [4.0]),
    "unknowns": edits.set_unknowns({"mass": ["part1"], "stiffness": []}, ABLE, {}),
    "bounds": edits.set_bounds("part1.mass", 0.5, 2.0, GROUPS),
}


@pytest.mark.parametrize("name", EDITS)
@pytest.mark.parametrize("text", BAD)
def test_an_edit_of_what_is_no_job_gives_toml_or_one_message(text: str, name: str) -> None:
    message = ""
    try:
        tomlkit.parse(edited(EDITS[name], text))
    except InputError as error:
        message = str(error)
    assert not message or "edit the text of the job" in message


def test_only_groups_that_have_the_quantity_are_named():
    able = {"stiffness": GROUPS[:-1], "mass": GROUPS, "loss_factor": GROUPS[:-1]}
    chosen = {"stiffness": GROUPS[:1]}
    text = edited(edits.set_unknowns(chosen, able, {}))
    left = [t for t in tomllib.loads(text)["parameter"] if t["quantity"] == "stiffness"]
    assert [t["groups"] for t in left] == [GROUPS[:1]]
