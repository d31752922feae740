"""The classical algorithms from which the fully mixed methods were developed, with the interface of all methods.

| algorithm        | in                   | what it solves, and what "converged" means                                 |
|------------------|----------------------|----------------------------------------------------------------------------|
| uzawa            | `primal_uzawa`       | (VL) in P1: natural residual of the vertex values below 1e-8               |
| psor             | `over_relaxation`    | (VI) in P1: likewise                                                       |
| primal-pdas      | `primal_sets`        | (VI) in P1: likewise                                                       |
| primal-penalty   | `primal_sets`        | (P_ε) in P1: likewise, u_i ≥ 0 relaxed to u_i + ελ_i ≥ 0                   |
| mixed-uzawa1     | `mixed_uzawa`        | (MLM-I)_h: all its KKT residuals below 1e-8                                |
| mixed-uzawa2     | `mixed_uzawa`        | (MLM-II)_h: likewise                                                       |
| mixed-uzawa-h12  | `mixed_uzawa`        | (MLM-II)_h: likewise                                                       |
| mixed-uzawa-wang | `stabilised`         | (MVI)_h: likewise                                                          |
| slimane          | `stabilised`         | ∇·σ + f_h = εu for (9b): KKT residuals with the load f_h − εu below 1e-8   |
| qp               | `quadratic`          | (MVI)_h in the form of theorem 2: all KKT residuals below 1e-8             |

The P1 methods, penalties and Slimane's method solve other discrete problems, so they are judged by
`Outcome.own_residual`. The KKT residuals of (9) are reported for all methods, unchanged. For the P1 methods dual,
complementarity and mass balance are of the order of the discretisation error; for Slimane's method the mass balance is
of order ε.
"""
