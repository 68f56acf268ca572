/* What the rules below do with matrices, row by row: so many of them follow one another. */

static double least(double a, double b)
{
    return a < b || a != a ? a : b;
}

static double most(double a, double b)
{
    return a > b || a != a ? a : b;
}

static double sign(double x)
{
    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x;
}

/* Entries of stretches: the first one, how many, and so on. */
static void gather(double *out, const double *x, const int *runs, int count)
{
    int k, n;

    for (k = 0; k < count; k += 2)
        for (n = 0; n < runs[k + 1]; ++n)
            *out++ = x[runs[k] + n];
}

static void matmul(double *out, const double *a, const double *b, int m, int k, int n, int count, double *work)
{
    int i, j, l;

    (void)work;
    for (; count > 0; --count, a += m * k, b += k * n, out += m * n)
        for (i = 0; i < m; ++i)
            for (j = 0; j < n; ++j) {
                double total = 0.0;
                for (l = 0; l < k; ++l)
                    total += a[i * k + l] * b[l * n + j];
                out[i * n + j] = total;
            }
}

static void exchange(double *a, double *b, int count)
{
    int k;

    for (k = 0; k < count; ++k) {
        const double kept = a[k];
        a[k] = b[k];
        b[k] = kept;
    }
}

/* Gauss's elimination with rows exchanged, in A (n, n) and b (n, columns): the determinant, and the solution in b. */
static double eliminate(double *A, double *b, int n, int columns)
{
    double determinant = 1.0;
    int i, j, k;

    for (k = 0; k < n; ++k) {
        int p = k;
        for (i = k + 1; i < n; ++i)
            if (fabs(A[i * n + k]) > fabs(A[p * n + k]))
                p = i;
        if (p != k) {
            exchange(A + p * n, A + k * n, n);
            exchange(b + p * columns, b + k * columns, columns);
            determinant = -determinant;
        }
        determinant *= A[k * n + k];
        for (i = k + 1; i < n; ++i) {
            const double f = A[i * n + k] / A[k * n + k];
            for (j = k; j < n; ++j)
                A[i * n + j] -= f * A[k * n + j];
            for (j = 0; j < columns; ++j)
                b[i * columns + j] -= f * b[k * columns + j];
        }
    }
    for (i = n - 1; i >= 0 && columns; --i)
        for (j = 0; j < columns; ++j) {
            for (k = i + 1; k < n; ++k)
                b[i * columns + j] -= A[i * n + k] * b[k * columns + j];
            b[i * columns + j] /= A[i * n + i];
        }
    return determinant;
}

static void solve(double *out, const double *A, const double *b, int n, int columns, int count, double *work)
{
    for (; count > 0; --count, A += n * n, b += n * columns, out += n * columns) {
        memcpy(work, A, (size_t)(n * n) * sizeof(double));
        memcpy(out, b, (size_t)(n * columns) * sizeof(double));
        eliminate(work, out, n, columns);
    }
}

static void det(double *out, const double *A, int n, int count, double *work)
{
    for (; count > 0; --count, A += n * n) {
        memcpy(work, A, (size_t)(n * n) * sizeof(double));
        *out++ = eliminate(work, work, n, 0);
    }
}

static double dot(const double *a, const double *b, int n)
{
    double total = 0.0;
    int k;

    for (k = 0; k < n; ++k)
        total += a[k] * b[k];
    return total;
}

static void rotate(double *a, double *b, int n, double cosine, double sine)
{
    int k;

    for (k = 0; k < n; ++k) {
        const double x = a[k], y = b[k];
        a[k] = cosine * x - sine * y;
        b[k] = sine * x + cosine * y;
    }
}

/* Singular values of A (m, n), largest first, and right singular vectors, the rows of V (n, n): one-sided Jacobi
   rotations of the columns. work : m n + n. */
static void singular(const double *A, int m, int n, double *sizes, double *V, double *work)
{
    double *U = work;
    const double nothing = 1e-33 * dot(A, A, m * n);
    int i, j, p, q, round, turned = 1;

    for (i = 0; i < n; ++i) {
        for (j = 0; j < m; ++j)
            U[i * m + j] = A[j * n + i];
        for (j = 0; j < n; ++j)
            V[i * n + j] = i == j;
    }
    for (round = 0; round < 60 && turned; ++round) {
        turned = 0;
        for (p = 0; p < n; ++p)
            for (q = p + 1; q < n; ++q) {
                const double a = dot(U + p * m, U + p * m, m), b = dot(U + q * m, U + q * m, m);
                const double c = dot(U + p * m, U + q * m, m);
                if (fabs(c) > most(1e-16 * sqrt(a * b), nothing)) {
                    const double zeta = (b - a) / (2.0 * c);
                    const double t = (zeta < 0.0 ? -1.0 : 1.0) / (fabs(zeta) + hypot(1.0, zeta));
                    const double cosine = 1.0 / hypot(1.0, t);
                    rotate(U + p * m, U + q * m, m, cosine, cosine * t);
                    rotate(V + p * n, V + q * n, n, cosine, cosine * t);
                    turned = 1;
                }
            }
    }
    for (i = 0; i < n; ++i)
        sizes[i] = sqrt(dot(U + i * m, U + i * m, m));
    for (i = 0; i < n; ++i) {
        p = i;
        for (j = i + 1; j < n; ++j)
            if (sizes[j] > sizes[p])
                p = j;
        exchange(sizes + i, sizes + p, p != i);
        exchange(V + i * n, V + p * n, p != i ? n : 0);
    }
}

static void sigma(double *out, const double *A, int m, int n, int count, double *work)
{
    const int small = m < n ? m : n;

    for (; count > 0; --count, A += m * n, out += small) {
        singular(A, m, n, work, work + n, work + n + n * n);
        memcpy(out, work, (size_t)small * sizeof(double));
    }
}

static void right_vectors(double *out, const double *A, int m, int n, int count, double *work)
{
    const int small = m < n ? m : n;

    for (; count > 0; --count, A += m * n, out += small * n) {
        singular(A, m, n, work, work + n, work + n + n * n);
        memcpy(out, work + n, (size_t)(small * n) * sizeof(double));
    }
}

/* The pseudoinverse (n, m) without singular values below a part of the largest. */
static void pinv(double *out, const double *A, int m, int n, int count, double part, double *work)
{
    const int small = m < n ? m : n;
    int i, j, k;

    for (; count > 0; --count, A += m * n, out += n * m) {
        singular(A, m, n, work, work + n, work + n + n * n);
        for (k = 0; k < n * m; ++k)
            out[k] = 0.0;
        for (k = 0; k < small; ++k) {
            const double *v = work + n + k * n, size = work[k];
            if (!(size > part * work[0]))
                continue;
            for (i = 0; i < m; ++i) {
                const double u = dot(A + i * n, v, n) / size;
                for (j = 0; j < n; ++j)
                    out[j * m + i] += v[j] * u / size;
            }
        }
    }
}

static void sort(double *out, const double *x, int n, int count, double *work)
{
    int i, j;

    (void)work;
    memcpy(out, x, (size_t)(n * count) * sizeof(double));
    for (; count > 0; --count, out += n)
        for (i = 1; i < n; ++i) {
            const double own = out[i];
            for (j = i; j > 0 && out[j - 1] > own; --j)
                out[j] = out[j - 1];
            out[j] = own;
        }
}

/* Of each matrix (rows, length) the row of a number; from the end where that is negative. */
static void row(double *out, const double *x, const double *places, int rows, int length, int given, int count, double *work)
{
    int k;

    (void)work;
    for (k = 0; k < count; ++k) {
        const int place = (int)places[k * given / count];
        memcpy(out + k * length, x + (k * rows + (place < 0 ? place + rows : place)) * length,
               (size_t)length * sizeof(double));
    }
}
