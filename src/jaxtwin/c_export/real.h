/* Functions and limits of the type of all numbers. */
#include <float.h>
#include <math.h>

#if MODEL_IS_FLOAT
#define MODEL_EPSILON FLT_EPSILON
#define model_sqrt sqrtf
#define model_fabs fabsf
#define model_fmin fminf
#define model_fmax fmaxf
#define model_exp expf
#define model_erf erff
#define model_floor floorf
#define model_log logf
#define model_pow powf
#else
#define MODEL_EPSILON DBL_EPSILON
#define model_sqrt sqrt
#define model_fabs fabs
#define model_fmin fmin
#define model_fmax fmax
#define model_exp exp
#define model_erf erf
#define model_floor floor
#define model_log log
#define model_pow pow
#endif

/* For the laws of physics/laws/, whose powers have positive bases. */
#define model_number(constant) ((model_real)(constant))
#define model_raised(base, exponent) model_exp((exponent) * model_log(base))
