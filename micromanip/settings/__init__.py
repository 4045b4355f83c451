"""Configuration: YAML -> typed, validated model -> records of per-sample gains."""
