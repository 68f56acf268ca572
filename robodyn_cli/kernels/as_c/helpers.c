/* What the IR has and C has not. */

static double load_d(const char *p)
{
    double x;

    memcpy(&x, p, sizeof x);
    return x;
}

static int64_t load_l(const char *p)
{
    int64_t x;

    memcpy(&x, p, sizeof x);
    return x;
}

static char *load_p(const char *p)
{
    char *x;

    memcpy(&x, p, sizeof x);
    return x;
}

static void store_d(char *p, double x)
{
    memcpy(p, &x, sizeof x);
}

static void store_l(char *p, int64_t x)
{
    memcpy(p, &x, sizeof x);
}

static void store_p(char *p, char *x)
{
    memcpy(p, &x, sizeof x);
}

static int64_t bits(double x)
{
    int64_t n;

    memcpy(&n, &x, sizeof n);
    return n;
}

static double of_bits(int64_t n)
{
    double x;

    memcpy(&x, &n, sizeof x);
    return x;
}

static double maximum(double a, double b)
{
    return a > b || a != a ? a : b;
}

static double minimum(double a, double b)
{
    return a < b || a != a ? a : b;
}

/* The lowest bit that is set; there is one. */
static int64_t lowest(int64_t n)
{
    int64_t k = 0;

    while (!(n >> k & 1))
        ++k;
    return k;
}
