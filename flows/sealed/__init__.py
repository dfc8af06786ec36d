"""Stages of the sealed suites; see sealed/dvc.yaml."""
