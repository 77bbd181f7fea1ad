"""Problems with published optima, solved as a user would: with the package's defaults.

``table.PROBLEMS`` lists them; every function of the modules that it gathers states one problem in
the words of :class:`~microbot_ocp.ocp.OptimalControlProblem`, in natural units, without scales,
shapes of controls or meshes, and with a starting guess only where the source gives one.
``python -m benchmarks suite`` solves each in child processes with a limit of time, next to plain
CasADi with IPOPT; ``python -m benchmarks.suite.confirm`` recomputes the published figures on fine
meshes without the package.
"""
