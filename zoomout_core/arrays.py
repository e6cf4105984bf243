"""What an array holds, for the reader."""

from typing import Any, TypeAlias

from numpy.typing import NDArray

# numpy's own types differ too much from version to version to be checked.
Floats: TypeAlias = NDArray[Any]
Integers: TypeAlias = NDArray[Any]
Booleans: TypeAlias = NDArray[Any]
