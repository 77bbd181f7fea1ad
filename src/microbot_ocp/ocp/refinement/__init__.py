"""Mesh refinement until a solution passes the judgement, or has a wanted accuracy.

Input: a converged solution and its transcription. Output: the solution that passes, with the
history of its meshes. Begin with :func:`judged`; ``_accuracy.py`` defines accuracies and the next
mesh, ``_refiner.py`` refines motions from mesh to mesh.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
