"""The C that solves the equations of motion under constraints, the same for all mechanisms."""

from __future__ import annotations

# M qdd - Psi^T lambda = f and Psi qdd + gamma = 0, whatever the rank of Psi: rows are eliminated with complete
# pivoting, which tells independent rows and dependent coordinates; the others follow from their reduced mass matrix.
SOLVE = """/* Solves A x = b, A (n x n), with partial pivoting; x takes the place of b. Returns 1 without an inverse. */
static int solve(int n, real *A, real *b)
{
    int i, j, k;

    for (k = 0; k < n; ++k) {
        int pivot = k;
        for (i = k + 1; i < n; ++i)
            if (F(fabs)(A[i * n + k]) > F(fabs)(A[pivot * n + k]))
                pivot = i;
        if (!(F(fabs)(A[pivot * n + k]) > 0))
            return 1;
        for (j = 0; j < n && pivot != k; ++j) {
            const real x = A[k * n + j];
            A[k * n + j] = A[pivot * n + j];
            A[pivot * n + j] = x;
        }
        if (pivot != k) {
            const real x = b[k];
            b[k] = b[pivot];
            b[pivot] = x;
        }
        for (i = k + 1; i < n; ++i) {
            const real factor = A[i * n + k] / A[k * n + k];
            for (j = k + 1; j < n; ++j)
                A[i * n + j] -= factor * A[k * n + j];
            b[i] -= factor * b[k];
        }
    }
    for (k = n - 1; k >= 0; --k) {
        for (j = k + 1; j < n; ++j)
            b[k] -= A[k * n + j] * b[j];
        b[k] /= A[k * n + k];
    }
    return 0;
}

/* Eliminates with complete pivoting: row[k] gives column[k], k < rank, as -A of the other columns. Returns the rank. */
static int eliminate(real A[ROWS][NV + 1], int *row, int *column)
{
    real first = 0;
    int rank, i, j, k;

    for (i = 0; i < ROWS; ++i)
        row[i] = i;
    for (j = 0; j < NV; ++j)
        column[j] = j;
    for (rank = 0; rank < ROWS && rank < NV; ++rank) {
        int best_row = rank, best_column = rank;
        real most = 0;
        for (i = rank; i < ROWS; ++i)
            for (j = rank; j < NV; ++j)
                if (F(fabs)(A[row[i]][column[j]]) > most) {
                    most = F(fabs)(A[row[i]][column[j]]);
                    best_row = i;
                    best_column = j;
                }
        first = rank ? first : most;
        if (!(most > LOST * first))
            break;
        k = row[rank];
        row[rank] = row[best_row];
        row[best_row] = k;
        k = column[rank];
        column[rank] = column[best_column];
        column[best_column] = k;
        {
            real *own = A[row[rank]];
            const real pivot = own[column[rank]];
            for (j = 0; j <= NV; ++j)
                own[j] /= pivot;
            for (i = 0; i < ROWS; ++i) {
                const real factor = A[i][column[rank]];
                if (i == row[rank])
                    continue;
                for (j = 0; j <= NV; ++j)
                    A[i][j] -= factor * own[j];
            }
        }
    }
    return rank;
}

/* Gives qdd and lambda of M qdd - Psi^T lambda = f, Psi qdd + gamma = 0; see the header for what it returns. */
static int solve_constrained(const real *M, const real *f, const real *Psi, const real *gamma, real *qdd, real *lambda)
{
    real A[ROWS][NV + 1], Z[NV][NV], H[NV * NV], g[NV], x[NV], left[NV], moved[NV], P[ROWS * ROWS], r[ROWS];
    int row[ROWS], column[NV], rank, count, i, j, k, l;

    for (i = 0; i < ROWS; ++i) {
        for (j = 0; j < NV; ++j)
            A[i][j] = Psi[i * NV + j];
        A[i][NV] = -gamma[i];
    }
    rank = eliminate(A, row, column);
    count = NV - rank;
    memset(Z, 0, sizeof Z); /* motions that the rows leave: qdd = x + Z g */
    for (i = 0; i < NV; ++i)
        x[column[i]] = i < rank ? A[row[i]][NV] : 0;
    for (k = 0; k < count; ++k) {
        Z[k][column[rank + k]] = 1;
        for (i = 0; i < rank; ++i)
            Z[k][column[i]] = -A[row[i]][column[rank + k]];
    }
    for (i = 0; i < NV; ++i) {
        left[i] = f[i];
        for (j = 0; j < NV; ++j)
            left[i] -= M[i * NV + j] * x[j];
    }
    for (k = 0; k < count; ++k) {
        g[k] = 0;
        for (i = 0; i < NV; ++i) {
            g[k] += Z[k][i] * left[i];
            moved[i] = 0;
            for (j = 0; j < NV; ++j)
                moved[i] += M[i * NV + j] * Z[k][j];
        }
        for (l = 0; l < count; ++l) {
            H[l * count + k] = 0;
            for (i = 0; i < NV; ++i)
                H[l * count + k] += Z[l][i] * moved[i];
        }
    }
    if (solve(count, H, g))
        return 2;
    for (i = 0; i < NV; ++i) {
        qdd[i] = x[i];
        for (k = 0; k < count; ++k)
            qdd[i] += Z[k][i] * g[k];
    }
    for (k = 0; k < rank; ++k) { /* the dependent coordinates tell lambda */
        r[k] = -f[column[k]];
        for (j = 0; j < NV; ++j)
            r[k] += M[column[k] * NV + j] * qdd[j];
        for (l = 0; l < rank; ++l)
            P[k * rank + l] = Psi[row[l] * NV + column[k]];
    }
    for (i = 0; i < ROWS; ++i)
        lambda[i] = 0;
    if (solve(rank, P, r))
        return 1;
    for (k = 0; k < rank; ++k)
        lambda[row[k]] = r[k];
    return rank < RANK ? 1 : 0;
}
"""
