"""Reading and writing of files: one module per format, selected by a lazy registry.

The functions here are the public interface. They detect the format by the content of a file, then
by its suffix (or use ``format=``), import only the module of that format, and check the options by
name. Unexpected exceptions of a reader become a `FormatError` here. Formats: `updyn.io.formats`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import ArrayLike

from updyn.errors import FormatError, OptionError, key_path, suggest
from updyn.frf import check_quantity
from updyn.io.formats import FORMATS, find_format, load
from updyn.io.items import guard_reader, locate_errors, parse_selection
from updyn.io.point_files import has_fields, read_point_files

if TYPE_CHECKING:
    import xarray

    from updyn.dofs import Dof
    from updyn.dynamics.modes import Modes
    from updyn.frf import FRF
    from updyn.geometry import Geometry
    from updyn.modal import ModeSet
    from updyn.modal.shapes import Updated
    from updyn.model import Model
    from updyn.signals.records import Records

__all__ = [
    "read_contents",
    "read_frf",
    "read_geometry",
    "read_model",
    "read_modes",
    "read_records",
    "write_frf",
    "write_model",
    "write_modes",
    "write_properties",
    "write_shapes",
]


class UpdateParameters(Protocol):
    """Unknowns of an update, as used by `write_properties`."""

    def changes(self, values: Sequence[float]) -> Mapping[str, dict[str, float]]:
        """Return the changes by group for values of the unknowns."""


class SplitsChanges(Protocol):
    """An updated model, as used by `write_properties`."""

    def split_changes(
        self, changes: Mapping[str, Mapping[str, float]]
    ) -> dict[str, dict[str, float]]:
        """Return changes by original group."""


class UpdateOutcome(Protocol):
    """The outcome of an update, as used by `write_properties`."""

    @property
    def model(self) -> SplitsChanges:
        """The updated model."""

    @property
    def parameters(self) -> UpdateParameters:
        """The unknowns."""

    @property
    def values(self) -> Mapping[str, float]:
        """Estimate by unknown."""


def read_frf(
    path: str | Path,
    *,
    format: str | None = None,
    quantity: str | None = None,
    duplicates: str = "raise",
    responses: Iterable[str | Dof] | None = None,
    references: Iterable[str | Dof] | None = None,
    **options: Any,
) -> FRF:
    """Read frequency response functions.

    Parameters
    ----------
    path : path
        The file: universal file (58, 58b), netCDF-4/HDF5, ``.npz``, ``.mat`` or CSV. A name with
        fields in braces, such as ``"point_{node}{axis}.csv"``, reads all files that match and joins
        their FRFs (`joined_frfs`). A field matches an integer or a direction, such as X or -RZ;
        its text replaces the field in all texts of `options`.
    format : str, optional
        Format name, to force it: "uff", "netcdf", "npz", "mat", "csv".
    quantity : {"receptance", "mobility", "accelerance", "transmissibility"}, optional
        Measured quantity, required if the file does not state it. A contradiction is an error.
    duplicates : {"raise", "average"}
        Treatment of several functions at one pair of response and reference: an error, or their
        mean, weighted with the coherence if every function has one. Formats with a single function
        per pair accept only "raise".
    responses, references : iterable of str or Dof, optional
        DOFs to read, in this order; all others are ignored. With the opposite sign ("5:-Z") the
        values change sign. In a universal file only the selected part has to be complete.
    **options
        Further options of the reader, checked by name: ``real_valued=True`` for every format if
        the values are real with phase 0 or pi; ``scalar_direction``, ``scale`` and ``local_axes``
        for universal files (`updyn.io.uff.frf`); ``response_labels``, ``reference_labels`` and
        ``order`` for arrays without labels (`updyn.io.npz`, `updyn.io.matlab`); ``columns`` for
        tables of any layout and any suffix (`updyn.io.csv_columns`), and ``variables`` for arrays
        of other names (`updyn.io.frf_variables`).

    Returns
    -------
    FRF
        The FRFs in SI units, in the order of the file or of the selection.

    Raises
    ------
    FormatError
        If the file does not exist, no format fits, the content is not valid, or a response or
        reference is missing; the message gives the place.
    OptionError
        If the format has no such option; the message gives the nearest one.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> updyn.write_frf(chain.measure(), "chain.csv")
    >>> updyn.read_frf("chain.csv", responses=["12:X"]).responses.labels
    ['12:X']
    """
    if has_fields(path):
        given = {"format": format, "quantity": quantity, "duplicates": duplicates, **options}
        joined = read_point_files(path, read_frf, given)
        return _select_part(joined, _list_given(responses=responses, references=references), path)
    if format is None and options.get("columns") is not None:
        format = "csv"  # a table of text, whatever its suffix
    try:
        reader, name = _find_function(path, "read_frf", format)
    except FormatError as error:
        proposal = load(FORMATS["csv"]).propose_columns(path, error)
        if proposal is None:
            raise
        raise proposal from error
    wanted = _list_given(responses=responses, references=references)
    early = wanted if {"responses", "references"} <= _reader_options(reader) else {}
    given = {"quantity": quantity, "duplicates": duplicates, **early, **options}
    known = _check_option_names(reader, name, given, ("responses", "references"))
    if quantity is not None:  # an invalid quantity is an error in itself
        with locate_errors(path), key_path("quantity"):
            check_quantity(quantity)
    with guard_reader(path, name):
        frf: FRF = reader(path, **known)
        return frf if early else _select_part(frf, wanted, path)


def write_frf(frf: FRF, path: str | Path, *, format: str | None = None) -> None:
    """Write frequency response functions.

    An existing file is replaced only once the new one is complete.

    Parameters
    ----------
    frf : FRF
        The data.
    path : path
        File to write; its suffix selects the format.
    format : str, optional
        Format name, to force it.

    Raises
    ------
    FormatError
        If no format fits, or the format cannot hold the data.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> updyn.write_frf(chain.measure(), "chain.uff")
    >>> updyn.read_frf("chain.uff").quantity
    'accelerance'
    """
    _find_function(path, "write_frf", format)[0](frf, path)


def read_geometry(path: str | Path, *, format: str | None = None, **options: Any) -> Geometry:
    """Read node positions.

    Parameters
    ----------
    path : path
        A universal file (datasets 15, 2411, 2412, 2420, 82), a Nastran deck, an OUTPUT2 file of
        Nastran, an Exodus II mesh, or a table ``node,x,y,z``.
    format : str, optional
        Format name, to force it: "uff", "nastran", "op2", "exodus" or "csv".
    **options
        Options of the reader, checked by name: for every format ``unit``, the unit of length if
        the file does not state one, by default "m".

    Returns
    -------
    Geometry
        Positions in m in the global system, with the lines to draw of the file.

    Raises
    ------
    FormatError
        If the file does not exist, no format fits, or the content is not valid; the message gives
        the place.
    OptionError
        If the format has no such option; the message gives the nearest one.

    Examples
    --------
    >>> with open("nodes.csv", "w") as file:
    ...     for row in ("node,x,y,z", "1,0,0,0", "2,250,0,0"):
    ...         print(row, file=file)
    >>> updyn.read_geometry("nodes.csv", unit="mm").position([2])
    array([[0.25, 0.  , 0.  ]])
    """
    return _run_reader(path, "read_geometry", format, options)  # type: ignore[no-any-return]


def read_records(
    path: str | Path,
    *,
    format: str | None = None,
    units: Mapping[str, str] | None = None,
    factors: Mapping[str, float] | None = None,
    **options: Any,
) -> xarray.DataArray:
    r"""Read time records.

    Parameters
    ----------
    path : path
        A LabVIEW measurement file (.lvm), TDMS, MDF 4, a universal file (58, 58b), WAV, MATLAB,
        netCDF-4, HDF5 or a table in text.
    format : str, optional
        Format name, to force it: "lvm", "tdms", "mdf", "uff", "wav", "mat", "netcdf", "csv".
    units : mapping of str to str, optional
        Unit by channel if the file does not state it; a contradiction is an error.
    factors : mapping of str to float, optional
        Factors on the values of channels, such as the inverse of a sensitivity; the unit of the
        result is that of `units`.
    **options
        Options of the reader, checked by name: docs/formats.md.

    Returns
    -------
    xarray.DataArray
        Dimensions ``record`` (hits or runs, from 1), ``channel`` and ``time`` (s, from 0 in each
        record), with the coordinate ``unit`` along ``channel``; values in these units.

    Raises
    ------
    FormatError
        If the file does not exist, no format fits, or the content is not valid; the message gives
        the place.
    OptionError
        If the format has no such option; the message gives the nearest one.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = "time,hammer,1:Z\n0.0,0.0,0.0\n0.1,5.0,0.2\n0.2,0.0,0.1\n"
    >>> _ = Path("hit.csv").write_text(text)
    >>> records = updyn.read_records("hit.csv", units={"hammer": "N", "1:Z": "g"})
    >>> records.shape  # records, channels, samples
    (1, 2, 3)
    """
    records: Records = _run_reader(path, "read_records", format, options)
    with locate_errors(path):
        return records.calibrate(units, factors).to_xarray()


def read_modes(path: str | Path, *, format: str | None = None, **options: Any) -> ModeSet:
    """Read measured modes.

    Parameters
    ----------
    path : path
        A universal file with datasets 55 or 2414 (normal or complex modes), a netCDF-4 file (.nc)
        of `write_modes`, an OUTPUT2 file of Nastran (.op2), or a table of natural frequencies
        (.csv, .txt; one test per line, or with a header one mode per line).
    format : str, optional
        Format name, to force it: "uff", "netcdf", "op2" or "csv".
    **options
        Options of the reader, checked by name: for an OUTPUT2 file ``unit`` and ``subcase``; for a
        table ``test`` (number of the line, from 1; by default the mean over all lines) and
        ``modes`` (numbers of the columns or lines, from 1).

    Returns
    -------
    ModeSet
        Frequencies in Hz, loss factors, shapes, and the DOFs of their rows. Tables have no shapes.

    Raises
    ------
    FormatError
        If the file does not exist, no format fits, or the content is not valid; the message gives
        the place.
    OptionError
        If the format has no such option; the message gives the nearest one.

    Examples
    --------
    >>> import numpy as np
    >>> modes = updyn.ModeSet(np.array([12.0, 31.0]), np.eye(2), ["1:Z", "2:Z"])
    >>> updyn.write_modes(modes, "modes.uff")
    >>> updyn.read_modes("modes.uff").dofs.labels
    ['1:Z', '2:Z']
    """
    return _run_reader(path, "read_modes", format, options)  # type: ignore[no-any-return]


def read_contents(path: str | Path, *, format: str | None = None, **options: Any) -> Any:
    """Read the whole content of a file that holds several kinds of data.

    Parameters
    ----------
    path : path
        A Nastran OUTPUT2 file (.op2).
    format : str, optional
        Format name, to force it: "op2".
    **options
        Options of the reader, checked by name: ``unit``.

    Returns
    -------
    Contents
        Names of tables and matrices, geometry and modes (`updyn.io.nastran.op2`).

    Raises
    ------
    FormatError
        If the file does not exist, no format fits, or the file is damaged.
    OptionError
        If the format has no such option; the message gives the nearest one.
    """
    return _run_reader(path, "read_contents", format, options)


def write_modes(
    modes: ModeSet, path: str | Path, *, format: str | None = None, **options: object
) -> None:
    """Write measured modes, to be read by `read_modes`.

    An existing file is replaced only once the new one is complete.

    Parameters
    ----------
    modes : ModeSet
        The modes.
    path : path
        File to write; its suffix selects the format: netCDF-4 (.nc, without loss, with standard
        deviations), a universal file, or a table (.csv) for modes without shapes.
    format : str, optional
        Format name, to force it.
    **options
        Options of the writer, checked by name: for a universal file ``geometry`` (`Geometry`,
        written too) and ``dataset`` (55, the default, or 2414).

    Raises
    ------
    FormatError
        If no format fits, or the format cannot hold the modes.
    OptionError
        If the format has no such option; the message gives the nearest one.

    See Also
    --------
    write_shapes : Also computed modes and operating shapes, as animation or for ParaView.

    Examples
    --------
    >>> import numpy as np
    >>> modes = updyn.ModeSet(np.array([12.0, 31.0]), np.eye(2), ["1:Z", "2:Z"])
    >>> updyn.write_modes(modes, "modes.uff")
    >>> updyn.read_modes("modes.uff").frequency
    array([12., 31.])
    """
    writer, name = _find_function(path, "write_modes", format)
    writer(modes, path, **_check_option_names(writer, name, options, ("format",)))


def write_shapes(
    shapes: ModeSet | Modes | FRF,
    path: str | Path,
    structure: Geometry | Model | Updated | None = None,
    *,
    freq: ArrayLike | None = None,
    reference: str | None = None,
    select: ArrayLike | None = None,
    format: str | None = None,
    **options: object,
) -> None:
    """Write mode shapes or operating shapes on their structure, for other programs.

    An existing file is replaced only once the new one is complete.

    Parameters
    ----------
    shapes : ModeSet, Modes or FRF
        Measured modes, computed modes (`updyn.modes`), or FRFs, whose values at some frequencies
        are operating deflection shapes.
    path : path
        File to write; its suffix selects the format: .gif, .mp4, .vtu, .unv or .uff.
    structure : Geometry, Model or UpdateResult, optional
        Positions of the nodes. None: the geometry of the FRF.
    freq : array_like of float, optional
        Frequencies of operating shapes in Hz; the nearest line of the FRF is used.
    reference : str, optional
        Reference of operating shapes, if the FRF has several.
    select : array_like of int or bool, optional
        Modes to write, by number from 0 or a flag for each. None: all.
    format : str, optional
        Format name, to force it.
    **options
        Options of the writer, checked by name: docs/formats.md.

    Raises
    ------
    FormatError
        If no format fits, or the format cannot hold the shapes.
    InputError
        If the geometry, the frequency or the reference is missing or does not fit, or a measured
        node has no position.

    Examples
    --------
    >>> import numpy as np
    >>> modes = updyn.ModeSet(np.array([12.0, 31.0]), np.eye(2), ["1:Z", "2:Z"])
    >>> geometry = updyn.Geometry([1, 2], [[0, 0, 0], [1, 0, 0]], [[1, 2]])
    >>> updyn.write_shapes(modes, "modes.unv", geometry)
    >>> updyn.read_geometry("modes.unv").nodes
    array([1, 2])
    """
    from updyn.modal.shapes import make_shapes  # on use; its import is slow

    writer, name = _find_function(path, "write_shapes", format)
    known = _check_option_names(writer, name, options, ("freq", "reference", "select", "format"))
    made = make_shapes(shapes, structure, freq=freq, reference=reference, select=select)
    writer(made, path, **known)


def read_model(
    path: str | Path,
    *,
    format: str | None = None,
    groups: Mapping[str, str | Iterable[str]] | None = None,
    **options: Any,
) -> Model:
    """Read a model.

    Parameters
    ----------
    path : path
        The file.
    format : str, optional
        Format name, to force it.
    groups : mapping of str to str or iterable of str, optional
        Groups to merge, as patterns by name of the new group (`Model.merge_groups`): ``{"wing":
        "PSHELL 1-4", "tip": ["CONM2 10*", "PBAR 7"]}``. For element matrices of Ansys also
        element numbers.
    **options
        Options of the reader, checked by name.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If the file does not exist, no format fits, the content is not valid, or groups cannot be
        merged; the message gives the place.
    OptionError
        If the format has no such option; the message gives the nearest one.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> updyn.write_model(chain.build(), "chain.h5")
    >>> updyn.read_model("chain.h5").n_dofs
    12
    >>> updyn.read_model("chain.h5", groups={"root": "part1-2"})
    Model(12 DOFs, 3 groups: root, part3, part4)
    """
    if groups is None:
        return _run_reader(path, "read_model", format, options)  # type: ignore[no-any-return]
    given = _split_groups(_find_function(path, "read_model", format)[0], groups)
    if given.elements is not None:
        options = {**options, "groups": given.elements}
    model: Model = _run_reader(path, "read_model", format, options)
    if given.patterns is None:
        return model
    with locate_errors(path):
        return model.merge_groups(given.patterns)


def write_model(model: Model, path: str | Path, *, format: str | None = None) -> None:
    """Write a model.

    An existing file is replaced only once the new one is complete.

    Parameters
    ----------
    model : Model
        The model.
    path : path
        File to write; its suffix selects the format.
    format : str, optional
        Format name, to force it.

    Raises
    ------
    FormatError
        If no format fits, or the format cannot hold the model.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> updyn.write_model(chain.build(), "chain.npz")
    >>> updyn.read_model("chain.npz").groups.keys() == chain.build().groups.keys()
    True
    """
    write = _find_function(path, "write_model", format)[0]
    if write.__module__ != "updyn.io.hdf5":
        model.refuse_nonlinear(f"{Path(path).name}: only .h5 files store nonlinear elements")
    write(model, path)


def write_properties(
    result: UpdateOutcome | Mapping[str, Mapping[str, float]],
    deck: str | Path,
    path: str | Path,
    *,
    format: str | None = None,
) -> None:
    """Write the updated properties of groups to a file that the source deck can include.

    Parameters
    ----------
    result : UpdateResult or mapping of str to mapping of str to float
        The outcome of an update, or changes by group as for `Model.scaled`: ``stiffness``,
        ``mass`` and ``viscous`` as factors on the values of the deck, ``loss_factor`` as a value.
    deck : path
        The source deck of the model, which is not changed.
    path : path
        File to write. An existing file is replaced only once the new one is complete.
    format : str, optional
        Format name of the deck, to force it.

    Raises
    ------
    FormatError
        If no format fits, or the deck has no such group or property.
    OptionError
        If the file to write is the deck.

    Examples
    --------
    >>> cards = ["GRID,1,,0.,0.,0.", "GRID,2,,1.,0.,0.", "CROD,1,3,1,2", "PROD,3,7,1.-4"]
    >>> with open("rod.bdf", "w") as file:
    ...     for card in (*cards, "MAT1,7,2.1+11,,0.3,7850.", "ENDDATA"):
    ...         print(card, file=file)
    >>> updyn.write_properties({"PROD 3": {"stiffness": 1.1}}, "rod.bdf", "updated.bdf")
    >>> with open("updated.bdf") as file:
    ...     print(file.read(), end="")
    $ New values of properties of rod.bdf; comments give the replaced cards.
    $ Instead of MAT1 7 (rod.bdf, line 5):
    $   MAT1,7,2.1+11,,0.3,7850.
    MAT1*                  72.31000000000+11                             0.3
    *                  7850.
    """
    source, target = Path(deck), Path(path)
    if target.exists() and source.exists() and target.samefile(source):
        raise OptionError(f"{path}: is the deck itself, which is not changed; give another file")
    if isinstance(result, Mapping):
        changes = {group: dict(change) for group, change in result.items()}
    else:
        by_group = result.parameters.changes(list(result.values.values()))
        changes = result.model.split_changes(by_group)
    writer, name = _find_function(deck, "write_properties", format)
    with guard_reader(deck, name):
        writer(changes, source, target)


def _run_reader(path: str | Path, verb: str, format: str | None, options: dict[str, object]) -> Any:
    reader, name = _find_function(path, verb, format)
    known = _check_option_names(reader, name, options, ("format",))
    with guard_reader(path, name):
        return reader(path, **known)


def _find_function(
    path: str | Path, verb: str, format: str | None
) -> tuple[Callable[..., Any], str]:
    """Return the function `verb` of the format of the file, and the name of the format."""
    chosen = find_format(path, verb, format)
    return getattr(load(chosen), verb), chosen.name


@dataclass(frozen=True, slots=True)
class _GivenGroups:
    """Groups by element numbers, for a reader of element matrices, and groups to merge."""

    elements: Mapping[str, Any] | None
    patterns: Mapping[str, Any] | None


def _split_groups(reader: Callable[..., object], groups: Mapping[str, Any]) -> _GivenGroups:
    """Return the groups of `read_model` by kind: only some readers know element numbers."""
    if "groups" not in _reader_options(reader) or not isinstance(groups, Mapping):
        return _GivenGroups(None, groups)
    listed = {n: [part] if isinstance(part, str) else list(part) for n, part in groups.items()}
    patterns = {n: part for n, part in listed.items() if any(isinstance(x, str) for x in part)}
    elements = {n: part for n, part in listed.items() if n not in patterns}
    return _GivenGroups(elements if elements or not patterns else None, patterns or None)


def _reader_options(reader: Callable[..., object]) -> set[str]:
    return {
        p.name for p in inspect.signature(reader).parameters.values() if p.kind is p.KEYWORD_ONLY
    }


def _check_option_names(
    reader: Callable[..., object], kind: str, options: dict[str, object], others: Iterable[str] = ()
) -> dict[str, object]:
    """Return the options after checking their names; `others` are names for messages only."""
    known = _reader_options(reader)
    for name in options:
        if name not in known:
            raise OptionError(
                f"{reader.__name__} of the format {kind!r} has no option {name!r}; "
                + suggest(name, sorted(known.union(others))),
                key=(name,),
            )
    return options


def _list_given(**selections: Iterable[str | Dof] | None) -> dict[str, Iterable[str | Dof]]:
    return {name: dofs for name, dofs in selections.items() if dofs is not None}


def _select_part(frf: FRF, wanted: Mapping[str, Iterable[str | Dof]], path: str | Path) -> FRF:
    """Select responses and references of FRFs, for formats without a selection while reading."""
    if "responses" in wanted:
        with locate_errors(path, "responses"):
            frf = frf.select(responses=parse_selection(wanted["responses"], "responses", path))
    if "references" in wanted:
        with locate_errors(path, "references"):
            frf = frf.select(references=parse_selection(wanted["references"], "references", path))
    return frf
