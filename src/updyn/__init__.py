"""updyn: finite-element model updating from measured frequency response functions.

Read a model and measured FRFs, choose the unknowns, update, judge, hand over::

    model = updyn.read_model("model.h5")
    frf = updyn.read_frf("test.uff")
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    result = updyn.update(model, frf, unknowns)
    print(result.summary())

Importing updyn loads numpy and scipy only; the names in ``__init__.pyi`` are loaded on first use.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ = ["__version__", *__all__]


def __dir__() -> list[str]:
    return sorted(__all__)
