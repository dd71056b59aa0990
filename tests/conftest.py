"""What every test runs under: float64, strict shapes and dtypes, a shared compile cache."""

import pathlib

import jax

_CACHE = pathlib.Path(__file__).resolve().parent.parent / ".jax_cache"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_compilation_cache_dir", str(_CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
