# COPS 3.0, problem 8: a telescoping arm from rest to rest in the shortest time.
import casadi as ca
import numpy as np
from rockit import DirectCollocation, FreeTime, Ocp

LENGTH = 5.0

ocp = Ocp(T=FreeTime(10.0))
rho, theta, phi = ocp.state(), ocp.state(), ocp.state()
rho_rate, theta_rate, phi_rate = ocp.state(), ocp.state(), ocp.state()
u_rho, u_theta, u_phi = ocp.control(), ocp.control(), ocp.control()
inertia = ((LENGTH - rho) ** 3 + rho**3) / 3
ocp.set_der(rho, rho_rate)
ocp.set_der(theta, theta_rate)
ocp.set_der(phi, phi_rate)
ocp.set_der(rho_rate, u_rho / LENGTH)
ocp.set_der(theta_rate, u_theta / (inertia * ca.sin(phi) ** 2))
ocp.set_der(phi_rate, u_phi / inertia)
for coordinate, start, end, lower, upper in (
    (rho, 4.5, 4.5, 0.0, LENGTH),
    (theta, 0.0, 2 * np.pi / 3, -np.pi, np.pi),
    (phi, np.pi / 4, np.pi / 4, 0.0, np.pi),
):
    ocp.subject_to(ocp.at_t0(coordinate) == start)
    ocp.subject_to(ocp.at_tf(coordinate) == end)
    ocp.subject_to(lower <= (coordinate <= upper))
    ocp.set_initial(coordinate, start)
for rate in (rho_rate, theta_rate, phi_rate):
    ocp.subject_to(ocp.at_t0(rate) == 0)
    ocp.subject_to(ocp.at_tf(rate) == 0)
for control in (u_rho, u_theta, u_phi):
    ocp.subject_to(-1 <= (control <= 1))
ocp.add_objective(ocp.T)
ocp.solver("ipopt", {"expand": True})
ocp.method(DirectCollocation(N=100, degree=3, scheme="radau"))
solution = ocp.solve()
print(solution.value(ocp.T))
