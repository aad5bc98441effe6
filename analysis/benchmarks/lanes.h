/* Contacts side by side, as many as fill a vector: the few operations on vectors that GCC's vector extensions do not
   spell, as AVX-512 or AVX2 instructions, or as loops over lanes that any other machine's compiler vectorises as it
   can; and log and exp. */
#include <stdint.h>

#if defined(__AVX2__) && defined(__FMA__) && !defined(__AVX512DQ__) && !defined(PORTABLE)
#define LANES 4
#else
#define LANES 8
#endif
typedef double real __attribute__((vector_size(8 * LANES)));
typedef int64_t whole __attribute__((vector_size(8 * LANES)));
typedef uint64_t word __attribute__((vector_size(8 * LANES)));
#define INLINE static inline __attribute__((always_inline))
#define ALL(x) ((real){} + (double)(x))

#if defined(__AVX512DQ__) && !defined(PORTABLE)
#include <immintrin.h>
#define BIG(a) ((__m512i)(a))
INLINE word multiply_low(word a, word b) { return (word)_mm512_mul_epu32(BIG(a), BIG(b)); }
INLINE word xor3(word a, word b, word c) { return (word)_mm512_ternarylogic_epi64(BIG(a), BIG(b), BIG(c), 0x96); }
INLINE real least(real a, real b) { return _mm512_min_pd(a, b); }
INLINE real most(real a, real b) { return _mm512_max_pd(a, b); }
INLINE real root(real a) { return _mm512_sqrt_pd(a); }
INLINE real exponent(real a) { return _mm512_getexp_pd(a); }
INLINE real mantissa(real a) { return _mm512_getmant_pd(a, _MM_MANT_NORM_1_2, _MM_MANT_SIGN_src); }
INLINE real converted(word a) { return __builtin_convertvector(a, real); }
INLINE whole rounded(real a) { return (whole)_mm512_cvtpd_epi64(a); }
INLINE whole rounded_up(real a) {
    return (whole)_mm512_cvt_roundpd_epi64(a, _MM_FROUND_TO_POS_INF | _MM_FROUND_NO_EXC);
}
/* entry (index mod 16) of a table of 16: a shuffle of two registers, four times as fast as a gather */
INLINE real pick(const double *table, word index) {
    return _mm512_permutex2var_pd(_mm512_load_pd(table), BIG(index), _mm512_load_pd(table + 8));
}
INLINE unsigned above(real a, real b) { return _mm512_cmp_pd_mask(a, b, _CMP_GT_OQ); }
INLINE real where(unsigned mask, real a) { return _mm512_maskz_mov_pd(mask, a); }
/* the lanes of `keep` to the front; all eight are written */
INLINE void squeeze(double *to, unsigned keep, real a) { _mm512_storeu_pd(to, _mm512_maskz_compress_pd(keep, a)); }
#elif LANES == 4
#include <immintrin.h>
#define BIG(a) ((__m256i)(a))
INLINE word multiply_low(word a, word b) { return (word)_mm256_mul_epu32(BIG(a), BIG(b)); }
INLINE word xor3(word a, word b, word c) { return a ^ b ^ c; }
INLINE real least(real a, real b) { return _mm256_min_pd(a, b); }
INLINE real most(real a, real b) { return _mm256_max_pd(a, b); }
INLINE real root(real a) { return _mm256_sqrt_pd(a); }
INLINE real exponent(real a) { return (real)((word)a >> 52 | (word)ALL(0x1p52)) - (0x1p52 + 1023); }
INLINE real mantissa(real a) { return (real)(((word)a & 0xfffffffffffff) | (word)ALL(1.0)); }
/* in halves, as there is no instruction for 64 bits: what is added leaves an integer in the last bits */
INLINE real converted(word a) {
    real high = (real)(a >> 32 | (word)ALL(0x1p84)) - (0x1p84 + 0x1p52);
    return high + (real)_mm256_blend_epi32(BIG(a), BIG(ALL(0x1p52)), 0xaa);
}
INLINE whole rounded(real a) {
    real r = _mm256_round_pd(a, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
    real high = _mm256_floor_pd(r * 0x1p-32);
    return ((whole)(high + 0x1.8p52) << 32) + ((whole)((r - high * 0x1p32) + 0x1p52) ^ (whole)ALL(0x1p52));
}
INLINE whole rounded_up(real a) { return (whole)(_mm256_ceil_pd(a) + 0x1p52) ^ (whole)ALL(0x1p52); }
INLINE real pick(const double *table, word index) {
    return _mm256_i64gather_pd(table, _mm256_and_si256(BIG(index), _mm256_set1_epi64x(15)), 8);
}
INLINE unsigned above(real a, real b) { return _mm256_movemask_pd(_mm256_cmp_pd(a, b, _CMP_GT_OQ)); }
INLINE real where(unsigned mask, real a) {
    const whole bit = {1, 2, 4, 8};
    return (real)(((((whole){} + mask) & bit) == bit) & (whole)a);
}
/* the 32-bit halves of the lanes to keep, for each of 16 masks */
#define PACKED(m) {HALVES(m, 0), HALVES(m, 1), HALVES(m, 2), HALVES(m, 3)}
#define NTH(m, n) ((m) >> 0 & 1 && (n) == 0 ? 0 : NTH1(m, (n) - ((m) & 1)))
#define NTH1(m, n) ((m) >> 1 & 1 && (n) == 0 ? 1 : NTH2(m, (n) - ((m) >> 1 & 1)))
#define NTH2(m, n) ((m) >> 2 & 1 && (n) == 0 ? 2 : 3)
#define HALVES(m, n) 2 * NTH(m, n), 2 * NTH(m, n) + 1
static const int32_t packed[16][8] __attribute__((aligned(32))) = {
    PACKED(0), PACKED(1), PACKED(2),  PACKED(3),  PACKED(4),  PACKED(5),  PACKED(6),  PACKED(7),
    PACKED(8), PACKED(9), PACKED(10), PACKED(11), PACKED(12), PACKED(13), PACKED(14), PACKED(15)};
INLINE void squeeze(double *to, unsigned keep, real a) {
    __m256i order = _mm256_load_si256((const __m256i *)packed[keep]);
    _mm256_storeu_pd(to, (real)_mm256_permutevar8x32_epi32(BIG(a), order));
}
#else
#define EACH for (int i = 0; i < LANES; i++)
INLINE word multiply_low(word a, word b) { return (a & 0xffffffff) * (b & 0xffffffff); }
INLINE word xor3(word a, word b, word c) { return a ^ b ^ c; }
INLINE real least(real a, real b) { real y = {}; EACH y[i] = a[i] < b[i] ? a[i] : b[i]; return y; }
INLINE real most(real a, real b) { real y = {}; EACH y[i] = a[i] > b[i] ? a[i] : b[i]; return y; }
INLINE real root(real a) { real y = {}; EACH y[i] = __builtin_sqrt(a[i]); return y; }
INLINE real exponent(real a) { return __builtin_convertvector(((whole)a >> 52) - 1023, real); }
INLINE real mantissa(real a) { return (real)(((whole)a & 0xfffffffffffff) | 0x3ff0000000000000); }
INLINE real converted(word a) { return __builtin_convertvector(a, real); }
INLINE whole rounded(real a) { whole y = {}; EACH y[i] = (int64_t)__builtin_rint(a[i]); return y; }
INLINE whole rounded_up(real a) { whole y = {}; EACH y[i] = (int64_t)__builtin_ceil(a[i]); return y; }
INLINE real pick(const double *table, word index) { real y = {}; EACH y[i] = table[index[i] & 15]; return y; }
INLINE unsigned above(real a, real b) { unsigned mask = 0; EACH mask |= (unsigned)(a[i] > b[i]) << i; return mask; }
INLINE real where(unsigned mask, real a) { real y = {}; EACH y[i] = mask >> i & 1 ? a[i] : 0.0; return y; }
INLINE void squeeze(double *to, unsigned keep, real a) { EACH if (keep >> i & 1) *to++ = a[i]; }
#endif

static double centre_inverse[16] __attribute__((aligned(64))), centre_log[16] __attribute__((aligned(64)));
static double sixteenth_power[16] __attribute__((aligned(64)));

static void fill_tables(void) {
    for (int i = 0; i < 16; i++) {
        centre_inverse[i] = 1.0 / (1.0 + (i + 0.5) / 16);
        centre_log[i] = -__builtin_log(centre_inverse[i]);
        sixteenth_power[i] = __builtin_exp2(i / 16.0);
    }
}

/* ln a to 2e-13, a > 0 and normal: exponent, a table of 16 mantissas, and seven terms of the rest */
INLINE real ln(real a) {
    real m = mantissa(a);
    word cell = (word)m >> 48;
    real r = m * pick(centre_inverse, cell) - 1.0;
    real series = 1.0 / 5 + r * (-1.0 / 6 + r * (1.0 / 7));
    series = r * (1.0 + r * (-1.0 / 2 + r * (1.0 / 3 + r * (-1.0 / 4 + r * series))));
    return exponent(a) * 0.69314718055994530942 + (pick(centre_log, cell) + series);
}

/* exp(a) to 2e-13, |a| < 700: a power of 2, one of 2^(1/16), and six terms of the rest */
INLINE real raised(real a) {
    const double shift = 0x1.8p52; /* what is added to it is rounded to an integer, which its last bits hold */
    real k = a * (16 / 0.69314718055994530942) + shift;
    word bits = (word)k;
    real r = a - (k - shift) * (0.69314718055994530942 / 16);
    real series = 1.0 + r * (1.0 + r * (1.0 / 2 + r * (1.0 / 6 + r * (1.0 / 24 + r * (1.0 / 120)))));
    return (real)((word)(pick(sixteenth_power, bits) * series) + (bits >> 4 << 52));
}
