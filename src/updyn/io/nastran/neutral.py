"""Cards of bulk data that change neither stiffness nor mass of the structure, by purpose.

The list follows the summary of bulk data entries in the MSC Nastran Quick Reference Guide, with the
entries of Simcenter Nastran that have the same purpose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.fields import NastranLine

__all__ = ["NEUTRAL", "NEUTRAL_PARAMETERS", "check_neutral", "describe_neutral", "split_equations"]

_BY_PURPOSE = {
    "eigenvalues": ("ECHOOFF", "ECHOON", "EIGB", "EIGC", "EIGP", "EIGR", "EIGRL", "MODTRAK"),
    "loads": (
        "ACCEL", "ACCEL1", "DAREA", "DEFORM", "DELAY", "DLOAD", "DPHASE", "FORCE", "FORCE1",
        "FORCE2", "FREQ", "FREQ1", "FREQ2", "FREQ3", "FREQ4", "FREQ5", "GRAV", "LOAD", "LSEQ",
        "MOMENT", "MOMENT1", "MOMENT2", "PLOAD", "PLOAD1", "PLOAD2", "PLOAD4", "RANDPS", "RANDT1",
        "RFORCE", "RFORCE1", "RLOAD1", "RLOAD2", "SLOAD", "SPCD", "TABDMP1", "TABLED1", "TABLED2",
        "TABLED3", "TABLED4", "TABRND1", "TABRNDG", "TEMP", "TEMPD", "TEMPP1", "TEMPRB", "TIC",
        "TLOAD1", "TLOAD2", "TSTEP",
    ),
    "reduction and sets": (
        "ASET", "ASET1", "BNDGRID", "BSET", "BSET1", "CSET", "CSET1", "EPOINT", "ITER", "OMIT",
        "OMIT1", "QSET", "QSET1", "SEQGP", "SUPORT", "SUPORT1", "SUPORT6", "USET", "USET1",
    ),
    "optimisation": (
        "BEADVAR", "DCONADD", "DCONSTR", "DDVAL", "DEQATN", "DESVAR", "DLINK", "DOPTPRM", "DRESP1",
        "DRESP2", "DRESP3", "DSCREEN", "DTABLE", "DVBSHAP", "DVCREL1", "DVCREL2", "DVGEOM",
        "DVGRID", "DVMREL1", "DVMREL2", "DVPREL1", "DVPREL2", "DVSET", "DVSHAP", "TOPVAR",
    ),
    "output": (
        "CBARAO", "MONPNT1", "MONPNT2", "MONPNT3", "PLOTEL", "PLOTEL3", "PLOTEL4", "PLOTOPT",
        "POINT", "SET", "SET1", "SET3",
    ),
    "nonlinear analysis": (
        "MATS1", "NLCNTL", "NLCNTL2", "NLPARM", "NLPCI", "NLSTEP", "TABLES1", "TSTEP1", "TSTEPNL",
    ),
    "aeroelasticity": (
        "AECOMP", "AECOMPL", "AEDW", "AEFACT", "AEFORCE", "AELINK", "AELIST", "AEPARM", "AEPRESS",
        "AERO", "AEROS", "AESCALE", "AESTAT", "AESURF", "AESURFS", "CAERO1", "CAERO2", "CAERO3",
        "CAERO4", "CAERO5", "CSSCHD", "DIVERG", "DMI", "FLFACT", "FLUTTER", "GUST", "MKAERO1",
        "MKAERO2", "PAERO1", "PAERO2", "PAERO3", "PAERO4", "PAERO5", "SPLINE1", "SPLINE2",
        "SPLINE3", "SPLINE4", "SPLINE5", "TRIM", "TRIM2", "UXVEC",
    ),
    "heat transfer": (
        "CHBDYE", "CHBDYG", "CHBDYP", "CONV", "CONVM", "MAT4", "MAT5", "PCONV", "PCONVM", "PHBDY",
        "QBDY1", "QBDY2", "QBDY3", "QHBDY", "QVECT", "QVOL", "RADBC", "RADM", "TEMPBC",
    ),
    "parameters": ("MDLPRM",),
}  # fmt: skip
#: Purposes that are not noted: decks of modes and responses have these cards, and updyn computes
#: both by itself.
_ROUTINE = ("eigenvalues", "loads")
NEUTRAL = frozenset(name for names in _BY_PURPOSE.values() for name in names)
#: PARAM cards that only select output, solutions or units of output, or that are applied to the
#: groups afterwards (G, ALPHA1, ALPHA2).
NEUTRAL_PARAMETERS = (
    "ALPHA1", "ALPHA2", "AUNITS", "BAILOUT", "DDRMM", "G", "GPECT", "GRDPNT", "GRIDSEQ", "LGDISP",
    "LMODES", "NEWSEQ", "NOCOMPS", "NOELOP", "NOGPF", "OGEOM", "OIBULK", "OMACHPR", "OMID",
    "OPPHIPA", "OUGCORD", "OUNIT1", "OUNIT2", "POST", "POSTEXT", "PRGPST", "PRTMAXIM", "RESVEC",
    "SOLLIB", "SPARSTOR", "SRCOMPS", "UNITSYS", "USETPRT", "W3", "W4",
)  # fmt: skip
#: Parameters of MDLPRM without effect on the matrices of elements.
_MODEL_PARAMETERS = ("HDF5", "INTOUT", "MPCF129", "PEXTS4")


def split_equations(lines: Iterable[NastranLine]) -> tuple[list[NastranLine], int]:
    """Return the lines without the equations (DEQATN), which have no fields, and their number."""
    kept: list[NastranLine] = []
    count = 0
    within = False
    for line in lines:
        head = line.text.split(",")[0][:8].strip()
        within = line.text[:8].strip().upper().startswith("DEQATN") or (
            within and (not head or head[0] in "+*")
        )
        if not within:
            kept.append(line)
        elif head and head[0] not in "+*":
            count += 1
    return kept, count


def check_neutral(card: NastranCard) -> None:
    """Refuse a card that is neutral for some of its parameters only."""
    if card.name != "MDLPRM":
        return
    for at in range(0, len(card.fields), 2):
        name = card.text(at)
        if name and name not in _MODEL_PARAMETERS:
            raise card.error(
                f"MDLPRM: parameter {name!r} (field {at + 2}) may change the elements; without"
                f" effect: {', '.join(_MODEL_PARAMETERS)} (to ignore the card: ignore=['MDLPRM'])"
            )


def describe_neutral(names: Iterable[str]) -> str:
    """Return the names of neutral cards by purpose, with their numbers; empty for routine ones."""
    counts = Counter(names)
    parts = []
    for purpose, known in _BY_PURPOSE.items():
        found = [f"{name} ({counts[name]})" for name in known if counts[name]]
        if found and purpose not in _ROUTINE:
            parts.append(f"{purpose}: {', '.join(found)}")
    return "; ".join(parts)
