/* Lives of contacts with thresholds of n = 1, lengths in x_*, a vector of them at a time: from counters to stiffness
   and stretch at breaking. xi^2 = -ln(u1 u2), so that no table of thresholds is needed; breaking takes one exp, one ln
   and, for soft barriers, a polynomial of degree 9 in 16 cells, whose coefficients are picked from registers. */
#include "lanes.h"

enum { COLD, SOFT, STIFF };
enum { DEGREE = 9 };

typedef struct {
    int64_t breaking, general; /* general: k_i = k xi/sqrt(2), fixed delay; otherwise k_i = k, none */
    double b, w, delay;        /* k/(2 kT), omega/v, v tau */
    uint32_t key[2];
} Law;

static double inverse[(DEGREE + 1) * 16] __attribute__((aligned(64))), middle[16] __attribute__((aligned(64)));

/* `cells`, shape (DEGREE + 2, 16): middles of the cells of s + 1/2, coefficients of z/s from the highest, by `pick` */
void prepare(const double *cells) {
    fill_tables();
    for (int i = 0; i < 16; i++) middle[i] = cells[i];
    for (int i = 0; i < (DEGREE + 1) * 16; i++) inverse[i] = cells[16 + i];
}

/* z of s = ln(1 + erfi(z)), 3e-10; beyond the last cell by fixed point of z^2 = s - ln(2/sqrt(pi) Dawson(z)), rarely */
INLINE real erfi_inverse(real s) {
    real bounded = least(s, ALL(127.4)) + 0.5;
    word cell = (word)bounded >> 51; /* half octaves */
    real d = bounded - pick(middle, cell), z = pick(inverse, cell);
#pragma GCC unroll 16
    for (int i = 1; i <= DEGREE; i++) z = z * d + pick(inverse + 16 * i, cell);
    z *= s;
    if (__builtin_expect(above(s, ALL(127.4)) != 0, 0))
        for (int lane = 0; lane < LANES; lane++)
            if (s[lane] > 127.4) {
                double square = s[lane];
                for (int i = 0; i < 6; i++) {
                    double q = 0.5 / square, dawson = 1 + q * (1 + 3 * q * (1 + 5 * q * (1 + 7 * q)));
                    square = s[lane] + __builtin_log(__builtin_sqrt(3.14159265358979324 * square) / dawson);
                }
                z[lane] = __builtin_sqrt(square);
            }
    return z;
}

/* Philox4x32-10 of counters (contact, life): two 64-bit words a lane */
INLINE void philox(const uint32_t key[2], word contact, uint64_t life, word *a, word *b) {
    word c0 = contact, c1 = {}, c2 = (word){} + life, c3 = {};
    uint32_t k0 = key[0], k1 = key[1];
#pragma GCC unroll 10
    for (int round = 0; round < 10; round++, k0 += 0x9E3779B9, k1 += 0xBB67AE85) {
        /* upper halves of words are left dirty: a multiplication does not see them */
        word p0 = multiply_low(c0, (word){} + 0xD2511F53), p1 = multiply_low(c2, (word){} + 0xCD9E8D57);
        c0 = xor3(p1 >> 32, c1, (word){} + k0), c2 = xor3(p0 >> 32, c3, (word){} + k1), c1 = p1, c3 = p0;
    }
    *a = (c0 & 0xffffffff) | c1 << 32, *b = (c2 & 0xffffffff) | c3 << 32;
}

/* a few lives of each lane. Every step is a short loop of its own: the processor then works on many vectors at once,
   where in one long loop it would wait for a chain of results */
enum { CHUNK = 128 / LANES };
typedef struct {
    word id[CHUNK], a[CHUNK], b[CHUNK];
    real k[CHUNK], x[CHUNK], xx[CHUNK], s[CHUNK]; /* stiffness k_i/k, stretch at breaking, its square; clock, then scratch */
} Lives;

/* how much of a life is done: all but recording it, or less, to be timed */
enum { DRAWN, WITH_THRESHOLDS, BROKEN };

INLINE void live(const Law *law, int breaking, int general, uint64_t life, int n, int upto, Lives *l) {
    const double ln2 = 0.69314718055994530942, strength1 = law->b;
    for (int i = 0; i < n; i++) philox(law->key, l->id[i], life, &l->a[i], &l->b[i]);
    if (upto == DRAWN) return;
    for (int i = 0; i < n; i++) {
        real square;
        if (breaking == COLD) /* 64 bits each, in (0, 1] */
            square = 128 * ln2 - ln((converted(l->a[i]) + 0.5) *
                                    (converted(l->b[i]) + 0.5));
        else /* 43, 43 and 42 bits: xi reaches 7.7, whose like one of 1e25 contacts has */
            square = 86 * ln2 - ln((converted(l->a[i] >> 21) + 0.5) *
                                   (converted(l->b[i] >> 21) + 0.5));
        l->xx[i] = most(square, ALL(1e-13)), l->x[i] = root(l->xx[i]);
        l->k[i] = general ? l->x[i] * 0.70710678118654752440 : ALL(1.0);
    }
    if (breaking == COLD) return;
    for (int i = 0; i < n; i++) { /* clocks */
        word rest = (l->a[i] & 0x1fffff) << 21 | (l->b[i] & 0x1fffff);
        l->s[i] = most(42 * ln2 - ln(converted(rest) + 0.5), ALL(1e-13));
    }
    if (upto == WITH_THRESHOLDS) return;
    for (int i = 0; i < n; i++) {
        real clock = l->s[i];
        real strength = general ? strength1 * l->k[i] : ALL(strength1), barrier = strength * l->xx[i];
        /* exp(-barrier), no less than exp(-690), so that logarithms are of normal numbers */
        real tunnel = raised(-least(barrier, ALL(690.0)));
        if (breaking == SOFT) {
            real spent = 1.1283791670955125739 / law->w * clock * root(strength);
            l->s[i] = most(barrier + ln(tunnel + spent), ALL(1e-13));
        } else /* (1 - x/xi)^(3/2), from 0 to 1 */
            l->s[i] = most(-ln(tunnel + 1.5 / law->w * clock * strength * l->x[i]) / barrier, ALL(1e-30));
    }
    for (int i = 0; i < n; i++) {
        real xi = l->x[i];
        if (breaking == SOFT)
            l->x[i] = least(xi, erfi_inverse(l->s[i]) * (1.0 / root(general ? strength1 * l->k[i] : ALL(strength1))));
        else
            l->x[i] = xi - xi * raised(2.0 / 3 * ln(least(l->s[i], ALL(1.0))));
        l->xx[i] = l->x[i] * l->x[i];
    }
}
