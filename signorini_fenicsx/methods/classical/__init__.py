"""The classical algorithms that the fully mixed methods start from, behind the interface of the others.

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
| qp               | `quadratic`          | (MVI)_h as theorem 2 reads it: all KKT residuals below 1e-8                |

P1, penalty and Slimane's solutions are solutions of other discrete problems: what judges them is
`Outcome.own_residual`. The KKT residuals of (9) are reported for all methods as they are; of the P1 methods dual,
complementarity and mass balance are of the order of the discretisation error, of Slimane's the mass balance is of order
ε.
"""
