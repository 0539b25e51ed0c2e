"""Stands in for PyGObject: what aravis_camera.py asks of it."""


def require_version(name, version):
    assert (name, version) == ("Aravis", "0.8")
