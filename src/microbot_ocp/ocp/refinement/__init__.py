"""Meshes chosen until a solution passes, or has a wanted accuracy.

Comes in: a converged solution and its transcription. Goes out: the solution that passes, with the
history of its meshes. Begin with :func:`judged`; ``_accuracy.py`` has what an accuracy asks for and
the next mesh, ``_refiner.py`` solves from mesh to mesh for motions.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
