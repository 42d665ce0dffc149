"""The two-state Kalman observer by hand: a script to be read from top to bottom, with the Structured Text beside it.

Run it with `.venv/bin/python docs/kalman_by_hand.py`, or cell by cell (`# %%`) in an editor that knows notebooks. It
needs softplc's kernel and numpy, no server, no PLC and no configuration. Equation numbers are those of T. Turner,
"Discrete-Time Implementation of a Two-State Kalman Observer in a Scan-Based Real-Time Control Environment" (2026).
"""

import numpy as np

from softplc.kernel import AoiInputs, AoiState, aoi_lreal, aoi_real, steady_gains

# %% 1. One scan, line by line
# An axis has just been enabled at position 0, and now its encoder says 1. The Structured Text starts every enabled
# axis at its measurement, at rest, and this is what that leaves behind; u is the axis' unit.
#   IF NOT init THEN x_pred := x; x_dot_pred := 0.0; P[0] := 1.0; P[1] := 0.0; P[2] := 0.0; P[3] := 10.0; … init := 1;
# (In the text the start and the first predict and update share a scan. Here they are pulled apart, so that there is
# an innovation to look at: the numbers are what that scan would give, had the axis moved by 1 u within it.)

dt_s = 50.0 / 1000.0  #  dt_s := dt / 1000.0;                    the scan took 50 ms
x = 1.0  #               measured position, u
q_x = 0.01  #            how much the position may wander in a scan beside the model, u²
q_x_dot = 0.1  #         how much the velocity may change in a scan, (u/s)²
r_x = 4.0 / 3.0  #       variance of the encoder's noise, u²: U(−2, 2) has 4²/12

x_pred, x_dot_pred = 0.0, 0.0  #   estimates of the last scan
P = np.array([[1.0, 0.0], [0.0, 10.0]])  # and how sure of them we are: variances on the diagonal

# Predict the state: the axis goes on at the velocity that it has, equations (2) and (3).
x_pred = x_pred + dt_s * x_dot_pred  #   x_pred := x_pred + dt_s * x_dot_pred;

# Predict the covariance: FPFᵀ + Q, equation (6). The AOI writes out the four entries, (7) to (12):
#   x_cov[0] := (P[0] + dt_s * P[2]) + dt_s * (P[1] + dt_s * P[3]);    P00
#   x_cov[1] := (P[1] + dt_s * P[3]);                                  P01
#   x_cov[2] := (P[2] + dt_s * P[3]);                                  P10
#   x_cov[3] := (P[3]);                                                P11
#   x_cov[0] := x_cov[0] + q_x;   x_cov[3] := x_cov[3] + q_x_dot;
F = np.array([[1.0, dt_s], [0.0, 1.0]])
P = F @ P @ F.T + np.diag([q_x, q_x_dot])

# Innovation: what the measurement says that the prediction did not, and the variance to expect of it, (17).
y_res = x - x_pred  #   y_res := x - x_pred;
S = P[0, 0] + r_x  #    S := x_cov[0] + r_x;

# Gains: how much of the innovation to believe, (18). K1 is not zero although no velocity is measured: the
# prediction has coupled position and velocity in P. A surprise in position is evidence about velocity.
# (IF S > 0.0 THEN: where it is not, the text puts the prediction out and leaves K and P alone.)
K0 = P[0, 0] / S  #   K0 := x_cov[0] / S;
K1 = P[1, 0] / S  #   K1 := x_cov[2] / S;

# Correct, (19) and (20); then the covariance of what is known now, (16).
x_pred = x_pred + K0 * y_res  #           x_pred := x_pred + K0 * y_res;
x_dot_pred = x_dot_pred + K1 * y_res  #   x_dot_pred := x_dot_pred + K1 * y_res;
#   P[0] := (1.0 - K0) * x_cov[0];           P[1] := (1.0 - K0) * x_cov[1];
#   P[2] := x_cov[2] - (K1 * x_cov[0]);      P[3] := x_cov[3] - (K1 * x_cov[1]);      P[2] := P[1];
P = (np.eye(2) - np.array([[K0], [K1]]) @ np.array([[1.0, 0.0]])) @ P

print("1. One scan by hand")
print(f"   K0 = {K0:.10f}   K1 = {K1:.10f} 1/s   position {x_pred:.6f} u   velocity {x_dot_pred:.6f} u/s")

# Left out here: IF NOT EnableIn THEN init := 0; y := x; y_dot := 0.0; and for dt <= 0 the same outputs with the state
# untouched; and the optional bleed, IF ABS(x - x_pred) < BleedThresh THEN x_dot_pred := x_dot_pred * BleedFactor;
# `softplc/kernel/reference/aoi.py` has every statement in its place.

# The same by the kernel, which follows the Structured Text statement by statement. A state goes in, a new one comes
# out; nothing is hidden.
tuning = {"q_x": q_x, "q_x_dot": q_x_dot, "r_x": r_x}
after_start = AoiState(init=True, P=(1.0, 0.0, 0.0, 10.0))
state, result = aoi_lreal(after_start, AoiInputs(True, 1.0, 50.0, **tuning))
print(
    f"   K0 = {state.K0:.10f}   K1 = {state.K1:.10f} 1/s   position {state.y:.6f} u   velocity {state.y_dot:.6f} u/s"
)

# %% 2. The paper's experiment: ramp, hold, ramp, hold, with noise of U(−2, 2), every 50 ms; equation (23)

rng = np.random.default_rng(0)
velocity = np.repeat([10.0, 0.0, 10.0, 0.0], 300)  # u/s, 15 s each
truth = np.cumsum(velocity) * dt_s
measured = truth + rng.uniform(-2.0, 2.0, truth.size)

state, track = AoiState(), []
for z in measured:
    state, _ = aoi_lreal(state, AoiInputs(True, float(z), 50.0, **tuning))
    track.append(state)
position = np.array([each.y for each in track])
speed = np.array([each.y_dot for each in track])
hold, ramp = slice(450, 600), slice(150, 300)  # the second halves, where the observer has settled

print("2. Ramp and hold")
print(f"   noise while holding: {np.std(measured[hold]):.2f} u in, {np.std(position[hold] - truth[hold]):.2f} u out")
print(f"   velocity on the ramp: {np.mean(speed[ramp]):.2f} ± {np.std(speed[ramp]):.2f} u/s, true 10")
print(f"   overshoot at the stop: {np.max(position[300:450] - truth[300:450]):.2f} u, the price of constant velocity")

# %% 3. Where the gains go: at a constant time step they settle, and the observer is an α-β filter from then on

K0, K1 = steady_gains(q_x, q_x_dot, r_x, dt_s)
print("3. Gains")
print(f"   after {len(track)} scans K0 = {state.K0:.6f}, K1 = {state.K1:.6f}")
print(f"   in closed form     K0 = {K0:.6f}, K1 = {K1:.6f}")

# Trust the sensor less, and both fall: smoother and later. Let the velocity change more, and K1 rises.
for name, changed in (("r_x ten times", {"r_x": 10 * r_x}), ("q_x_dot ten times", {"q_x_dot": 10 * q_x_dot})):
    K0, K1 = steady_gains(**{**tuning, **changed}, dt_s=dt_s)
    print(f"   {name:<18} K0 = {K0:.6f}, K1 = {K1:.6f}")

# %% 4. Is the tuning right? The innovations say it
# If q and r are right, y²/S is 1 on average (NIS) and one innovation says nothing about the next.

y = np.array([each.y_res for each in track[20:]])
nis = y * y / np.array([each.S for each in track[20:]])
print("4. Consistency")
print(f"   mean NIS {np.mean(nis):.2f}, lag-1 correlation of the innovations {np.corrcoef(y[:-1], y[1:])[0, 1]:+.2f}")

# Let the observer believe that the sensor is four times worse than it is: S is too large, NIS too small.
state, nis = AoiState(), []
for z in measured:
    state, _ = aoi_lreal(state, AoiInputs(True, float(z), 50.0, q_x, q_x_dot, 4 * r_x))
    nis.append(state.y_res * state.y_res / state.S)
print(f"   mean NIS with r_x four times too large: {np.mean(nis[20:]):.2f}")

# %% 5. What a PLC computes: REAL has 24 bits
# In single precision every operation is rounded. Near the origin nobody sees it; far away counts are lost.

for origin in (0.0, 3e7):
    single, double = AoiState(), AoiState()
    for z in measured:
        single, _ = aoi_real(single, AoiInputs(True, origin + float(z), 50.0, **tuning))
        double, _ = aoi_lreal(double, AoiInputs(True, origin + float(z), 50.0, **tuning))
    difference = abs(float(single.y_dot) - double.y_dot)
    print(f"5. Velocity of REAL and LREAL {origin:.0e} u from the origin: {difference:.1e} u/s apart")
