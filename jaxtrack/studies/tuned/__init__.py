"""The studies of tuning by gradient: three cases, beside Optuna's TPE."""
