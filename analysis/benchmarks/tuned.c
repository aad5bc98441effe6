/* Rival C: eqsim's algorithm by hand; the limit of the machine.

   lives       in lives.h and lanes.h: as many contacts to a vector as it has lanes, all without branches, tables or calls
   short loops each step of a chunk of 128 lives is a loop of its own, so that many vectors are worked on at once
   lock-step   a batch of contacts lives its n-th lives together, so that all deposits of a sweep fall near each other
               and stay in the first-level cache; those that have reached the end are squeezed out
   deposits    64-bit integers of what does not depend on the grid point, so that a life takes back what it left; with
               no delay and one stiffness, only births move, and a life is one addition to two columns
   batches     the contacts of a batch share its sums, kept in vectors: no table, and the same bits on any threads */
#include <stdlib.h>
#include <string.h>

#include "lives.h"

enum { AREA, PINNED, BREAKS, STRETCH, SUMS }; /* of a quarter of the second half */

typedef struct {
    int64_t contacts, points, batches;
    double distance;
} Job;

typedef struct {
    double per_step, half, scale[5];
} Grid;

#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (whole){__VA_ARGS__})
#if LANES == 8
#define PAIRS_EVEN(a, b) SHUFFLE(a, b, 0, 8, 2, 10, 4, 12, 6, 14)
#define PAIRS_ODD(a, b) SHUFFLE(a, b, 1, 9, 3, 11, 5, 13, 7, 15)
#else
#define PAIRS_EVEN(a, b) SHUFFLE(a, b, 0, 4, 2, 6)
#define PAIRS_ODD(a, b) SHUFFLE(a, b, 1, 5, 3, 7)
#endif
typedef int64_t pair __attribute__((vector_size(16)));

/* one stiffness, no delay: column 0 counts births, column 1 their squares; breaking at `broke` is the next birth */
INLINE void leave_birth(const Grid *grid, pair *deposits, whole j, real born, real broke) {
    whole a = rounded((broke - born) * grid->scale[0]), b = rounded((broke - born) * (broke + born) * grid->scale[1]);
    whole odd_and_even[2] = {PAIRS_EVEN(a, b), PAIRS_ODD(a, b)};
    const pair *rows = (const pair *)odd_and_even;
    int64_t at[LANES]; /* through memory, which the compiler is kept from avoiding: 5 % faster */
    memcpy(at, &j, sizeof at);
    __asm__ volatile("" : "+m"(at));
    for (int i = 0; i < LANES; i++) deposits[at[i]] += rows[i / 2 + i % 2 * (LANES / 2)];
}

/* columns 1, k, k born, k^2, k^2 born, (k born)^2 of a row that fills a cache line: one addition there, one to undo */
INLINE void leave_life(const Grid *grid, whole *deposits, whole start, whole end, real k, real born) {
    real kb = k * born;
    whole c[6] = {(whole){} + 1};
    real columns[5] = {k, kb, k * k, k * kb, kb * kb};
#pragma GCC unroll 5
    for (int i = 0; i < 5; i++) c[i + 1] = rounded(columns[i] * grid->scale[i]);
    whole rows[LANES][8 / LANES]; /* the transpose */
#pragma GCC unroll 2
    for (int odd = 0; odd < 2; odd++) {
        whole p = odd ? PAIRS_ODD(c[0], c[1]) : PAIRS_EVEN(c[0], c[1]);
        whole q = odd ? PAIRS_ODD(c[2], c[3]) : PAIRS_EVEN(c[2], c[3]);
        whole r = odd ? PAIRS_ODD(c[4], c[5]) : PAIRS_EVEN(c[4], c[5]), none = {};
#if LANES == 8
        whole low = SHUFFLE(p, q, 0, 1, 8, 9, 2, 3, 10, 11), high = SHUFFLE(p, q, 4, 5, 12, 13, 6, 7, 14, 15);
        whole low_r = SHUFFLE(r, none, 0, 1, 8, 9, 2, 3, 10, 11), high_r = SHUFFLE(r, none, 4, 5, 12, 13, 6, 7, 14, 15);
        rows[odd][0] = SHUFFLE(low, low_r, 0, 1, 2, 3, 8, 9, 10, 11);
        rows[odd + 2][0] = SHUFFLE(low, low_r, 4, 5, 6, 7, 12, 13, 14, 15);
        rows[odd + 4][0] = SHUFFLE(high, high_r, 0, 1, 2, 3, 8, 9, 10, 11);
        rows[odd + 6][0] = SHUFFLE(high, high_r, 4, 5, 6, 7, 12, 13, 14, 15);
#else
        rows[odd][0] = SHUFFLE(p, q, 0, 1, 4, 5), rows[odd][1] = SHUFFLE(r, none, 0, 1, 4, 5);
        rows[odd + 2][0] = SHUFFLE(p, q, 2, 3, 6, 7), rows[odd + 2][1] = SHUFFLE(r, none, 2, 3, 6, 7);
#endif
    }
    for (int i = 0; i < LANES; i++)
        for (int part = 0; part < 8 / LANES; part++) {
            deposits[8 / LANES * start[i] + part] += rows[i][part];
            deposits[8 / LANES * end[i] + part] -= rows[i][part];
        }
}

INLINE void record(const Grid *grid, real sums[2][SUMS], real k, real born, real broke, int general) {
    for (int quarter = 0; quarter < 2; quarter++) {
        real low = ALL(grid->half * (1.0 + 0.5 * quarter)), high = low + 0.5 * grid->half;
        real start = most(born, low), end = least(broke, high), pinned = most(end - start, ALL(0.0));
        real area = pinned * (0.5 * (start + end) - born);
        sums[quarter][AREA] += general ? k * area : area;
        sums[quarter][PINNED] += pinned;
        unsigned inside = above(broke, low) & ~above(broke, high);
        sums[quarter][BREAKS] += where(inside, ALL(1.0));
        sums[quarter][STRETCH] += where(inside, broke - born);
    }
}

/* contacts first <= i < last to the end of the distance, in lock-step; returns their lives */
INLINE int64_t march(const Law *law, int breaking, int general, const Job *job, const Grid *grid, int64_t first,
                     int64_t last, double *position, double *contact, whole *deposits, real sums[2][SUMS]) {
    int64_t lives = 0, count = last - first;
    Lives l;
    for (int64_t i = 0; i < count; i++) position[i] = 0.0, ((int64_t *)contact)[i] = first + i;
    for (uint64_t life = 0; count > 0; life++) {
        for (int64_t i = count; i % LANES; i++) position[i] = 4 * job->distance; /* lanes to spare: beyond the end */
        int64_t kept = 0;
        for (int64_t from = 0; from < count; from += CHUNK * LANES) {
            int n = count - from < CHUNK * LANES ? (int)((count - from + LANES - 1) / LANES) : CHUNK;
            real at[CHUNK];
            memcpy(l.id, contact + from, sizeof l.id), memcpy(at, position + from, sizeof at);
            live(law, breaking, general, life, n, BROKEN, &l);
            for (int i = 0; i < n; i++) {
                real born = at[i], broke = born + l.x[i], next = general ? broke + law->delay : broke;
                /* what is beyond the last grid point goes to a row that nobody reads */
                whole end = rounded_up(least(broke * grid->per_step, ALL(job->points)));
                if (general) {
                    whole start = rounded_up(least(born * grid->per_step, ALL(job->points)));
                    leave_life(grid, deposits, start, end, l.k[i], born);
                } else
                    leave_birth(grid, (pair *)deposits, end, born, broke);
                if (above(next, ALL(grid->half))) record(grid, sums, l.k[i], born, broke, general);
                unsigned keep = ~above(next, ALL(job->distance)) & ((1 << LANES) - 1);
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
        for (int64_t i = 0; i < CHUNK * LANES; i++) ((int64_t *)l.id)[i] = from + i;
        live(law, breaking, general, batch, CHUNK, BROKEN, &l);
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

/* `count` lives (whole chunks) as far as `upto`, of which nothing is kept */
INLINE void strip(const Law *law, int breaking, int general, int upto, int64_t count) {
    Lives l;
    for (int64_t from = 0; from < count; from += CHUNK * LANES) {
        for (int64_t i = 0; i < CHUNK * LANES; i++) ((int64_t *)l.id)[i] = from + i;
        live(law, breaking, general, 0, CHUNK, upto, &l);
        __asm__ volatile("" : : "r"(&l) : "memory"); /* as if somebody read it */
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

static double power_below(double bound) {
    return __builtin_ldexp(1.0, 62 - (int)__builtin_ceil(__builtin_log2(bound)));
}

/* Deposits, shape (points, columns), divided by their scales, and sums, shape (batches, 2, SUMS), of all contacts from
   a fresh start; returns lives, or -1 where memory is short. Columns: 2 (uniform, no delay) or 8. */
int64_t trajectory(const Law *law, const Job *job, int threads, double *deposits, double *sums) {
    int64_t columns = law->general ? 8 : 2, size = columns * (job->points + 1), lives = 0;
    double reach = job->distance + 8.0, k = law->general ? 5.5 : 1.0, n = (double)job->contacts; /* xi < 7.8 */
    Grid grid = {(job->points - 1) / job->distance, 0.5 * job->distance, {0}};
    double bounds[5] = {k, k * reach, k * k, k * k * reach, k * k * reach * reach};
    if (!law->general) bounds[0] = reach, bounds[1] = reach * reach;
    for (int i = 0; i < 5; i++) grid.scale[i] = power_below(n * bounds[i]);
    int64_t *total = calloc(size, sizeof *total);
    int failed = !total;
#pragma omp parallel num_threads(threads) reduction(+ : lives) reduction(| : failed)
    {
        int64_t most_contacts = job->contacts / job->batches + 1 + CHUNK * LANES;
        int64_t *own = aligned_alloc(64, (size * sizeof *own + 63) / 64 * 64);
        double *position = malloc(most_contacts * sizeof *position), *contact = malloc(most_contacts * sizeof *contact);
        failed |= !own || !position || !contact;
        if (!failed) {
            memset(own, 0, size * sizeof *own);
#pragma omp for schedule(dynamic) nowait
            for (int64_t batch = 0; batch < job->batches; batch++) {
                int64_t first = job->contacts * batch / job->batches, last = job->contacts * (batch + 1) / job->batches;
                real both[2][SUMS] = {};
                FOR_KIND(lives += march, law, job, &grid, first, last, position, contact, (whole *)own, both)
                for (int i = 0; i < 2 * SUMS; i++)
                    for (int lane = 0; lane < LANES; lane++)
                        sums[batch * 2 * SUMS + i] += both[i / SUMS][i % SUMS][lane];
            }
#pragma omp critical
            for (int64_t i = 0; i < size; i++) total[i] += own[i];
        }
        free(own), free(position), free(contact);
    }
    for (int64_t i = 0; !failed && i < columns * job->points; i++) {
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

void stripped(const Law *law, int upto, int64_t count) {
    switch (upto) {
    case DRAWN: FOR_KIND(strip, law, DRAWN, count) break;
    case WITH_THRESHOLDS: FOR_KIND(strip, law, WITH_THRESHOLDS, count) break;
    case BROKEN: FOR_KIND(strip, law, BROKEN, count) break;
    }
}
