"""Where the repository and the data of the tests are."""

from pathlib import Path

#: The root of the repository.
ROOT = Path(__file__).parents[2]
#: The data of the tests.
DATA = ROOT / "tests" / "data"
#: Helpers of the tests, a folder that Python imports from.
SUPPORT = Path(__file__).parent
