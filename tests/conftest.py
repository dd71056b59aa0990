"""What every test runs under: float64, strict shapes and dtypes, a shared compile cache."""

import pathlib

import jax
import pytest

_CACHE = pathlib.Path(__file__).resolve().parent.parent / ".jax_cache"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_compilation_cache_dir", str(_CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

_MAPS = pathlib.Path("/proc/self/maps")
_MOST_MAPS = 30_000  # Linux lets a process have 65 530; compiled programs have some six each


@pytest.fixture(autouse=True, scope="module")
def _room_for_programs():
    """Forget what is compiled before there is no room for more, where XLA would crash."""
    yield
    if _MAPS.exists() and len(_MAPS.read_bytes().splitlines()) > _MOST_MAPS:
        jax.clear_caches()
