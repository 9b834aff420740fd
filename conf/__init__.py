"""Hydra's configuration files, installed as a package so that they are found from any folder."""
