# COPS 3.0, problem 8: a telescoping arm from rest to rest in the shortest time.
import casadi as ca
import numpy as np

from microbot_ocp.ocp import OptimalControlProblem, SolverSettings, solve

LENGTH = 5.0

problem = OptimalControlProblem("robot arm")
move = problem.phase("move", duration=(1.0, 20.0))
rho = move.state("rho", initial=4.5, final=4.5, lower=0.0, upper=LENGTH)
theta = move.state("theta", initial=0.0, final=2 * np.pi / 3, lower=-np.pi, upper=np.pi)
phi = move.state("phi", initial=np.pi / 4, final=np.pi / 4, lower=0.0, upper=np.pi)
rho_rate = move.state("rho_rate", initial=0.0, final=0.0)
theta_rate = move.state("theta_rate", initial=0.0, final=0.0)
phi_rate = move.state("phi_rate", initial=0.0, final=0.0)
u_rho = move.control("u_rho", lower=-1.0, upper=1.0, shape="polynomial")
u_theta = move.control("u_theta", lower=-1.0, upper=1.0, shape="polynomial")
u_phi = move.control("u_phi", lower=-1.0, upper=1.0, shape="polynomial")
inertia = ((LENGTH - rho) ** 3 + rho**3) / 3
move.derivative(rho, rho_rate)
move.derivative(theta, theta_rate)
move.derivative(phi, phi_rate)
move.derivative(rho_rate, u_rho / LENGTH)
move.derivative(theta_rate, u_theta / (inertia * ca.sin(phi) ** 2))
move.derivative(phi_rate, u_phi / inertia)
move.end_cost(move.duration)
solution = solve(problem, mesh=100, scheme="radau", settings=SolverSettings(tolerance=1e-8))
print(solution.duration)
