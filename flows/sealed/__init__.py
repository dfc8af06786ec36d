"""Stages of the sealed suites; see pipelines/sealed/dvc.yaml."""
