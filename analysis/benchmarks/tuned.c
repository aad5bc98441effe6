/* Rival C: eqsim's algorithm by hand, for thresholds of n = 1 and lengths in x_*; the limit of the machine. Per case:

   draws       one Philox4x32-10 block a life; xi^2 = -ln(u1 u2), so that no table of thresholds is needed
   breaking    one exp, one ln and, for soft barriers, a polynomial of degree 9 in 16 cells held in registers
   lock-step   a batch of contacts lives its n-th lives together, so that all deposits of a sweep fall near each other
               and stay in the first-level cache; those that have reached the end are squeezed out
   deposits    64-bit integers of what does not depend on the grid point, so that a life takes back what it left; with
               no delay and one stiffness, only births move, and a life is one addition to two columns
   batches     the contacts of a batch share its sums, kept in registers: no table, and the same bits on any threads */
#include <stdlib.h>
#include <string.h>

#include "lanes.h"

enum { COLD, SOFT, STIFF };
enum { AREA, PINNED, BREAKS, STRETCH, SUMS }; /* of a quarter of the second half */
enum { DEGREE = 9 };

typedef struct {
    int64_t breaking, general; /* general: k_i = k xi/sqrt(2), fixed delay; otherwise k_i = k, none */
    double b, w, gap;          /* k/(2 kT), omega/v, v tau */
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
enum { CHUNK = 16 };
typedef struct {
    word id[CHUNK], a[CHUNK], b[CHUNK];
    real k[CHUNK], x[CHUNK], xx[CHUNK], s[CHUNK]; /* stiffness k_i/k, stretch at breaking, its square; scratch */
} Lives;

INLINE void live(const Law *law, int breaking, int general, uint64_t life, int n, Lives *l) {
    const double ln2 = 0.69314718055994530942, strength1 = law->b;
    for (int i = 0; i < n; i++) philox(law->key, l->id[i], life, &l->a[i], &l->b[i]);
    for (int i = 0; i < n; i++) {
        real square;
        if (breaking == COLD) /* 64 bits each, in (0, 1] */
            square = 128 * ln2 - ln((__builtin_convertvector(l->a[i], real) + 0.5) *
                                    (__builtin_convertvector(l->b[i], real) + 0.5));
        else /* 43, 43 and 42 bits: xi reaches 7.7, whose like one of 1e25 contacts has */
            square = 86 * ln2 - ln((__builtin_convertvector(l->a[i] >> 21, real) + 0.5) *
                                   (__builtin_convertvector(l->b[i] >> 21, real) + 0.5));
        l->xx[i] = most(square, ALL(1e-13)), l->x[i] = root(l->xx[i]);
        l->k[i] = general ? l->x[i] * 0.70710678118654752440 : ALL(1.0);
    }
    if (breaking == COLD) return;
    for (int i = 0; i < n; i++) {
        word rest = (l->a[i] & 0x1fffff) << 21 | (l->b[i] & 0x1fffff);
        real clock = most(42 * ln2 - ln(__builtin_convertvector(rest, real) + 0.5), ALL(1e-13));
        real strength = general ? strength1 * l->k[i] : ALL(strength1), barrier = strength * l->xx[i];
        /* exp(-barrier), no less than exp(-690), so that logarithms are of normal numbers */
        real tunnel = raised(-least(barrier, ALL(690.0)));
        if (breaking == SOFT) {
            real r = general ? root(strength) : ALL(__builtin_sqrt(strength1));
            l->s[i] = most(barrier + ln(tunnel + 1.1283791670955125739 / law->w * clock * r), ALL(1e-13));
        } else /* (1 - x/xi)^(3/2), from 0 to 1 */
            l->s[i] = most(-ln(tunnel + 1.5 / law->w * clock * strength * l->x[i]) / barrier, ALL(1e-30));
    }
    for (int i = 0; i < n; i++) {
        real xi = l->x[i];
        if (breaking == SOFT)
            l->x[i] = least(xi, erfi_inverse(l->s[i]) / (general ? root(strength1 * l->k[i]) : ALL(__builtin_sqrt(strength1))));
        else
            l->x[i] = xi - xi * raised(2.0 / 3 * ln(least(l->s[i], ALL(1.0))));
        l->xx[i] = l->x[i] * l->x[i];
    }
}

typedef struct {
    int64_t contacts, points, batches;
    double distance;
} Way;

typedef struct {
    double per_step, half, scale[5];
} Grid;

#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (whole){__VA_ARGS__})
#define PAIRS_EVEN(a, b) SHUFFLE(a, b, 0, 8, 2, 10, 4, 12, 6, 14)
#define PAIRS_ODD(a, b) SHUFFLE(a, b, 1, 9, 3, 11, 5, 13, 7, 15)
typedef int64_t pair __attribute__((vector_size(16)));

/* one stiffness, no delay: column 0 counts births, column 1 their squares; breaking at `broke` is the next birth */
INLINE void leave_birth(const Grid *grid, pair *deposits, whole j, real born, real broke) {
    whole a = rounded((broke - born) * grid->scale[0]), b = rounded((broke - born) * (broke + born) * grid->scale[1]);
    whole odd_and_even[2] = {PAIRS_EVEN(a, b), PAIRS_ODD(a, b)};
    const pair *rows = (const pair *)odd_and_even;
    for (int i = 0; i < LANES; i++) deposits[j[i]] += rows[i / 2 + i % 2 * 4];
}

/* columns 1, k, k born, k^2, k^2 born, (k born)^2 of a row that fills a cache line: one addition there, one to undo */
INLINE void leave_life(const Grid *grid, whole *deposits, whole start, whole end, real k, real born) {
    real kb = k * born;
    whole c[6] = {(whole){} + 1};
    real columns[5] = {k, kb, k * k, k * kb, kb * kb};
#pragma GCC unroll 5
    for (int i = 0; i < 5; i++) c[i + 1] = rounded(columns[i] * grid->scale[i]);
    whole rows[LANES]; /* the transpose */
#pragma GCC unroll 2
    for (int odd = 0; odd < 2; odd++) {
        whole p = odd ? PAIRS_ODD(c[0], c[1]) : PAIRS_EVEN(c[0], c[1]);
        whole q = odd ? PAIRS_ODD(c[2], c[3]) : PAIRS_EVEN(c[2], c[3]);
        whole r = odd ? PAIRS_ODD(c[4], c[5]) : PAIRS_EVEN(c[4], c[5]), none = {};
        whole low = SHUFFLE(p, q, 0, 1, 8, 9, 2, 3, 10, 11), high = SHUFFLE(p, q, 4, 5, 12, 13, 6, 7, 14, 15);
        whole low_r = SHUFFLE(r, none, 0, 1, 8, 9, 2, 3, 10, 11), high_r = SHUFFLE(r, none, 4, 5, 12, 13, 6, 7, 14, 15);
        rows[odd] = SHUFFLE(low, low_r, 0, 1, 2, 3, 8, 9, 10, 11);
        rows[odd + 2] = SHUFFLE(low, low_r, 4, 5, 6, 7, 12, 13, 14, 15);
        rows[odd + 4] = SHUFFLE(high, high_r, 0, 1, 2, 3, 8, 9, 10, 11);
        rows[odd + 6] = SHUFFLE(high, high_r, 4, 5, 6, 7, 12, 13, 14, 15);
    }
    for (int i = 0; i < LANES; i++) deposits[start[i]] += rows[i], deposits[end[i]] -= rows[i];
}

INLINE void record(const Grid *grid, real sums[2][SUMS], real k, real born, real broke, int general) {
    for (int quarter = 0; quarter < 2; quarter++) {
        real low = ALL(grid->half * (1.0 + 0.5 * quarter)), high = low + 0.5 * grid->half;
        real start = most(born, low), end = least(broke, high), way = most(end - start, ALL(0.0));
        real area = way * (0.5 * (start + end) - born);
        sums[quarter][AREA] += general ? k * area : area;
        sums[quarter][PINNED] += way;
        unsigned inside = above(broke, low) & ~above(broke, high);
        sums[quarter][BREAKS] += where(inside, ALL(1.0));
        sums[quarter][STRETCH] += where(inside, broke - born);
    }
}

/* contacts first <= i < last to the end of the way, in lock-step; returns their lives */
INLINE int64_t march(const Law *law, int breaking, int general, const Way *way, const Grid *grid, int64_t first,
                     int64_t last, double *position, double *contact, whole *deposits, real sums[2][SUMS]) {
    int64_t lives = 0, count = last - first;
    Lives l;
    for (int64_t i = 0; i < count; i++) position[i] = 0.0, ((int64_t *)contact)[i] = first + i;
    for (uint64_t life = 0; count > 0; life++) {
        for (int64_t i = count; i % LANES; i++) position[i] = 4 * way->distance; /* lanes to spare: beyond the end */
        int64_t kept = 0;
        for (int64_t from = 0; from < count; from += CHUNK * LANES) {
            int n = count - from < CHUNK * LANES ? (int)((count - from + LANES - 1) / LANES) : CHUNK;
            real at[CHUNK];
            memcpy(l.id, contact + from, sizeof l.id), memcpy(at, position + from, sizeof at);
            live(law, breaking, general, life, n, &l);
            for (int i = 0; i < n; i++) {
                real born = at[i], broke = born + l.x[i], next = general ? broke + law->gap : broke;
                /* what is beyond the last grid point goes to a row that nobody reads */
                whole end = rounded_up(least(broke * grid->per_step, ALL(way->points)));
                if (general) {
                    whole start = rounded_up(least(born * grid->per_step, ALL(way->points)));
                    leave_life(grid, deposits, start, end, l.k[i], born);
                } else
                    leave_birth(grid, (pair *)deposits, end, born, broke);
                if (above(next, ALL(grid->half))) record(grid, sums, l.k[i], born, broke, general);
                unsigned keep = ~above(next, ALL(way->distance)) & 0xff;
                squeeze(position + kept, keep, next), squeeze(contact + kept, keep, (real)l.id[i]);
                kept += __builtin_popcount(keep);
            }
        }
        lives += count, count = kept;
    }
    return lives;
}

/* work/k and stretch of `count` lives (whole chunks), plainly drawn: sums and greatest lives, four numbers */
INLINE void average(const Law *law, int breaking, int general, uint64_t batch, int64_t count, double *sums) {
    real work = {}, stretch = {}, most_work = {}, most_stretch = {};
    Lives l;
    for (int64_t from = 0; from < count; from += CHUNK * LANES) {
        for (int i = 0; i < CHUNK; i++) l.id[i] = (word){0, 1, 2, 3, 4, 5, 6, 7} + (uint64_t)(from + LANES * i);
        live(law, breaking, general, batch, CHUNK, &l);
        for (int i = 0; i < CHUNK; i++) {
            real done = general ? 0.5 * l.k[i] * l.xx[i] : 0.5 * l.xx[i];
            work += done, stretch += l.x[i];
            most_work = most(most_work, done), most_stretch = most(most_stretch, l.x[i]);
        }
    }
    for (int i = 0; i < LANES; i++) {
        sums[0] += work[i], sums[1] += stretch[i];
        sums[2] = most_work[i] > sums[2] ? most_work[i] : sums[2];
        sums[3] = most_stretch[i] > sums[3] ? most_stretch[i] : sums[3];
    }
}

/* a copy of `work` for each kind of contacts, so that nothing is decided inside its loops */
#define FOR_KIND(work, law, ...)                                                                                       \
    switch (2 * (law)->breaking + (law)->general) {                                                                    \
    case 2 * COLD: work(law, COLD, 0, __VA_ARGS__); break;                                                             \
    case 2 * COLD + 1: work(law, COLD, 1, __VA_ARGS__); break;                                                         \
    case 2 * SOFT: work(law, SOFT, 0, __VA_ARGS__); break;                                                             \
    case 2 * SOFT + 1: work(law, SOFT, 1, __VA_ARGS__); break;                                                         \
    case 2 * STIFF: work(law, STIFF, 0, __VA_ARGS__); break;                                                           \
    case 2 * STIFF + 1: work(law, STIFF, 1, __VA_ARGS__); break;                                                       \
    }

static double power_below(double bound) { return __builtin_ldexp(1.0, 62 - (int)__builtin_ceil(__builtin_log2(bound))); }

/* Deposits, shape (points, columns), divided by their scales, and sums, shape (batches, 2, SUMS), of all contacts from
   a fresh start; returns lives, or -1 where memory is short. Columns: 2 (uniform, no delay) or 8. */
int64_t trajectory(const Law *law, const Way *way, int threads, double *deposits, double *sums) {
    int64_t columns = law->general ? 8 : 2, size = columns * (way->points + 1), lives = 0;
    double reach = way->distance + 8.0, k = law->general ? 5.5 : 1.0, n = (double)way->contacts; /* xi < 7.8 */
    Grid grid = {(way->points - 1) / way->distance, 0.5 * way->distance, {0}};
    double bounds[5] = {k, k * reach, k * k, k * k * reach, k * k * reach * reach};
    if (!law->general) bounds[0] = reach, bounds[1] = reach * reach;
    for (int i = 0; i < 5; i++) grid.scale[i] = power_below(n * bounds[i]);
    int64_t *total = calloc(size, sizeof *total);
    int failed = !total;
#pragma omp parallel num_threads(threads) reduction(+ : lives) reduction(| : failed)
    {
        int64_t most_contacts = way->contacts / way->batches + 1 + CHUNK * LANES;
        int64_t *own = aligned_alloc(64, (size * sizeof *own + 63) / 64 * 64);
        double *position = malloc(most_contacts * sizeof *position), *contact = malloc(most_contacts * sizeof *contact);
        failed |= !own || !position || !contact;
        if (!failed) {
            memset(own, 0, size * sizeof *own);
#pragma omp for schedule(dynamic) nowait
            for (int64_t batch = 0; batch < way->batches; batch++) {
                int64_t first = way->contacts * batch / way->batches, last = way->contacts * (batch + 1) / way->batches;
                real both[2][SUMS] = {};
                FOR_KIND(lives += march, law, way, &grid, first, last, position, contact, (whole *)own, both)
                for (int i = 0; i < 2 * SUMS; i++)
                    for (int lane = 0; lane < LANES; lane++) sums[batch * 2 * SUMS + i] += both[i / SUMS][i % SUMS][lane];
            }
#pragma omp critical
            for (int64_t i = 0; i < size; i++) total[i] += own[i];
        }
        free(own), free(position), free(contact);
    }
    for (int64_t i = 0; !failed && i < columns * way->points; i++) {
        int64_t column = i % columns - law->general;
        deposits[i] = (double)total[i] / (column < 0 || column > 4 ? 1.0 : grid.scale[column]);
    }
    free(total);
    return failed ? -1 : lives;
}

/* sums, shape (batches, 4), of `average` over `batches` times `count` lives */
void steady(const Law *law, int64_t batches, int64_t count, int threads, double *sums) {
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (int64_t batch = 0; batch < batches; batch++) { FOR_KIND(average, law, batch, count, sums + 4 * batch) }
}
